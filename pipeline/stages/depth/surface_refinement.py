"""A gel's surface corrected by its own optics, where one look-up per pixel cannot do: cast shadows and lens blur.

A look-up knows a pixel's colour and place only. Where a dent stands between an LED and a pixel, that LED's light is
missing there, and the look-up reads the darkness as a slope; over a steep rim the lens blur flattens the slopes. Both
follow from the surface, so they are found together with it (analysis by synthesis). Each round renders the surface as
it is known so far, z, on the untouched picture R,

    light = (R + c(grad z)) s(z),    c: colour change of a slope, s: share of the light that gets past the surface,

compares the change of the blurred light with the change of the picture, steps from grad z to slopes that explain the
rest r (Gauss-Newton on every pixel, J = s dc/dg),

    dg = A^-1 J' W r,    A = J' W J + pull,    W: Huber's weight of a colour, 0 where the camera sees nothing any more,

and integrates. What a pixel cannot say (a dark colour, light from one side) is left as the integration has it. The
rounds run on a coarse grid, one more on the picture's own pixels.

A wall is saturated: whatever its height, it looks alike. As long as all slopes count alike, what it lacks is taken from
the flanks that are seen well, round by round: from the true surface in the true light the rounds lead down. Where the
light explains most of the picture, more rounds ask for the surface that comes nearest to the slopes as far as the
colours tell them,

    minimise  sum (grad z - g - dg)' A (grad z - g - dg).

What stands on walls is raised first, as a whole (`walls`): from the true surface in the true light the rounds stay
there. What printed markers hide counts for nothing, and what is drawn is as black and as white as a camera's picture.

In a light that is not the unit's, colours are less sure than they are clear, and this would follow the clearest.

c is as described, from lamps far away, or what lamps close beside the gel make of it on the unit's own untouched
picture (`near_lamps.gains`): the one that leaves less of the picture unexplained is taken. Simulated units come out as
the first, most touches of a real GelSlim as the second, and those of a GelSight Mini ask for more (`own_light`).

Numbers without a source beside them are those that `benchmarks/depth_numbers.py` finds no better neighbour of: a third
less or half as much again changes the error by less than it does for the rounds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask
from pipeline.calibration import near_led_prior, slope_model
from pipeline.calibration.calibration_table import Calibration
from pipeline.calibration.markers import detect_markers, inpaint_markers, remove_printed_markers
from pipeline.physics import optics
from pipeline.physics.slopes import compute_slopes
from pipeline.sensors.reference_light import compute_reference_light
from pipeline.sensors.spec import Markers, SensorSpec
from pipeline.stages.depth.change_detection import ImageWindow
from pipeline.stages.depth.poisson import Integrator, solve_weighted_slopes
from pipeline.stages.depth.wall_correction import raise_walls

MAX_ITERATIONS = 4  # two leave a fifth more error of a GelSlim, whose lights are low
CG_STEPS = (
    6  # towards the surface that is nearest to a round's slopes as far as they are told; with twelve it is no nearer
)
FINE_CG_STEPS = 4  # the same for the round on the picture's own pixels, where only what is fine is still to be found
HUBER_GREY = 20.0  # larger misfits are dust, a reflection, or an optical description that is not this unit's
OUTSIDE_WEIGHT = np.float32(
    1e4
)  # grey levels squared per unit slope squared: level as surely as a colour in half light tells
_PULL = 500.0  # grey levels squared per unit slope squared: a colour in full light weighs a hundred times as much
_STEEPEST = np.float32(1.43)  # mm/mm, 55 degrees: the light hardly changes beyond
_SURE_PULL, _SURE_STEEPEST = 100.0, np.float32(4.0)  # in light that explains the picture: walls beside edges are 2 to 3
_LEAST_MM = -0.5  # no gel bulges out farther
_HARDLY = 0.8  # of what is usual: balls on a real Mini are read wrong by 60 % there, by 12 % elsewhere
_CELLS = 160  # of the rounds' grid, along the longer side of a picture
_BRIGHT_BLUR_PX = 3.0
_NO_BLUR = 0.3  # pixels: a Gaussian that narrow changes nothing


# What a slope changes: what the description says, or what it is from lamps that stand close. "sure" is as described,
# too, and known to explain the picture.
LightModel = Literal["even", "sure", "near"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ImagePatch:
    """The part of a picture that is worked on, at its own pixels or at coarser ones."""

    x_px: Floats  # (cols,) places in the whole picture, in its pixels
    y_px: Floats  # (rows,)
    change: Floats  # (rows, cols, 3) grey levels, smoothed
    reference: Floats  # (rows, cols, 3) the untouched picture
    changed: Mask  # (rows, cols) where the surface is looked for
    downsampling: int  # pixels of the picture to one of these, along each axis
    pixel_mm: float  # width of one of these: of the look-up, which may have been told another than the sensor's
    smoothing_px: float  # of the change, in pixels of the picture
    unmarked_share: Floats  # (rows, cols, 1) share of a pixel that no printed marker hides, now or before


def is_applicable(source: SensorSpec, calibration: Calibration) -> bool:
    """Whether the sensor's description tells its optics, and the look-up came from that description.

    A look-up that was fitted to presses has their shadows and blur in it.
    """
    return source.optics is not None and calibration.is_built_in


def extract_patch(
    image: Image, still: Floats, window: ImageWindow, smoothing_px: float, markers: Markers | None, pixel_mm: float
) -> ImagePatch:
    """The window of a picture, ready for `corrected`; `still` is the untouched one, in its light.

    Printed markers, where they are now and where they were, are filled in from around them.
    """
    import cv2

    here = (window.rows, window.cols)
    light = np.array(still[here], np.float32)
    change, bare = image[here].astype(np.float32) - light, np.ones(window.changed.shape, np.float32)
    if markers is not None:
        printed, bright = remove_printed_markers(still, markers, pixel_mm)
        hidden = printed[here] | detect_markers(image[here], markers, pixel_mm)
        change = inpaint_markers(change, hidden, markers, pixel_mm)
        light, bare = np.array(bright[here]), (~hidden).astype(np.float32)
    if smoothing_px > 0:
        change = np.asarray(cv2.GaussianBlur(change, (0, 0), smoothing_px), np.float32)
    x, y = (np.arange(a.start, a.stop, dtype=np.float32) for a in (window.cols, window.rows))
    return ImagePatch(
        x_px=x, y_px=y, change=change, reference=light, changed=window.changed, downsampling=1, pixel_mm=pixel_mm,
        smoothing_px=smoothing_px, unmarked_share=bare[..., None],
    )  # fmt: skip


def downsample_patch(picture: ImagePatch, shape: tuple[int, ...], cells: int = _CELLS) -> ImagePatch:
    """The same on a grid of at most `cells` cells along a picture of `shape`; each is the mean of its pixels.

    Lens blur leaves nothing finer in the light, and the rounds cost the same at any resolution.
    """
    by = max(1, round(max(shape) / (cells * picture.downsampling)))
    if by == 1:
        return picture
    rows, cols = (-(-n // by) for n in picture.changed.shape)
    middle, step = np.float32(0.5 * (by - 1) * picture.downsampling), by * picture.downsampling
    return ImagePatch(
        x_px=picture.x_px[0] + middle + step * np.arange(cols, dtype=np.float32),
        y_px=picture.y_px[0] + middle + step * np.arange(rows, dtype=np.float32),
        change=compute_cell_means(picture.change, by), reference=compute_cell_means(picture.reference, by),
        changed=compute_cell_means(picture.changed.astype(np.float32), by) > 0, unmarked_share=compute_cell_means(picture.unmarked_share, by).reshape(rows, cols, 1),
        downsampling=step, pixel_mm=by * picture.pixel_mm, smoothing_px=picture.smoothing_px,
    )  # fmt: skip


def compute_cell_means(image: Floats, by: int) -> Floats:
    """Means of an image (rows, cols, ...) over cells of `by` x `by` pixels; the last ones as if it went on."""
    import cv2

    rows, cols = (-(-n // by) for n in image.shape[:2])
    more = (0, rows * by - image.shape[0], 0, cols * by - image.shape[1])
    whole = cv2.copyMakeBorder(image, *more, cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(whole, (cols, rows), interpolation=cv2.INTER_AREA), np.float32)


def upsample_surface(surface_mm: Floats, by: int, shape: tuple[int, ...]) -> Floats:
    """A surface of `coarser` at the picture's own pixels (rows, cols)."""
    import cv2

    if by == 1:
        return surface_mm
    rows, cols = surface_mm.shape
    fine = cv2.resize(surface_mm, (cols * by, rows * by), interpolation=cv2.INTER_CUBIC)
    return np.ascontiguousarray(fine[: shape[0], : shape[1]], np.float32)


def look_up_slopes(picture: ImagePatch, calibration: Calibration) -> tuple[Floats, Floats]:
    """What the look-up makes of the pixels, (gx, gy) in mm/mm."""
    half = 0.5 * max(calibration.rows, calibration.cols)
    u, v = (picture.x_px - 0.5 * (calibration.cols - 1)) / half, (picture.y_px - 0.5 * (calibration.rows - 1)) / half
    change = picture.change * slope_model.compute_gain(picture.reference)
    return slope_model.evaluate(calibration.model, change, u.astype(np.float32), v.astype(np.float32), picture.changed)


def refine_surface(
    surface_mm: Floats, picture: ImagePatch, source: SensorSpec, light: LightModel, integrated: Integrator,
    iterations: int = MAX_ITERATIONS, cg_steps: int = CG_STEPS,
) -> tuple[Floats, float]:  # fmt: skip
    """The surface (rows, cols) of the pixels whose picture comes nearest to the one seen, and what it leaves of it.

    From a first guess of the surface; what is left is in grey levels, summed over the pixels, before the last round.
    `integrated` makes slopes (gx, gy) of these pixels a surface in mm; in a light that is "sure", each round takes
    `steps` of it towards the `nearest`. Needs a sensor that `applies`.
    """
    from pipeline.stages.depth.surface_refinement_kernels import TILE_PX, render_pixels, update_slopes

    told, camera = optics.require_optics(source), source.camera
    pixel_mm, size = picture.pixel_mm, np.array([camera.cols, camera.rows], np.float32)
    place = (picture.x_px, picture.y_px, size, *optics.pack_leds(told, camera), np.float32(told.vignette))
    bright, out, misfit = _brightness(source, picture, light), np.empty_like(picture.change), 0.0
    pull, steepest = (_SURE_PULL, _SURE_STEEPEST) if light == "sure" else (_PULL, _STEEPEST)
    limits = (np.float32(pull), np.float32(HUBER_GREY), steepest, OUTSIDE_WEIGHT)
    line, sure = np.empty(6 * TILE_PX, np.float32), np.empty_like(picture.change)
    still, change = flatten_colours(picture.reference), flatten_colours(picture.change)
    for _ in range(iterations):
        z = clip_surface(surface_mm, picture, source)
        gx, gy = compute_slopes(z, pixel_mm)
        share = compute_light_share(source, z, pixel_mm)
        render_pixels(
            gx, gy, place, (still, flatten_colours(bright), flatten_colours(share)), line, flatten_colours(out)
        )
        rest = (picture.change - simulate_recorded_change(out, source, picture)) * picture.unmarked_share
        shone = (still, flatten_colours(bright), flatten_colours(share * picture.unmarked_share))
        misfit = update_slopes(
            flatten_colours(rest), change, picture.changed, place, shone, limits, line, gx, gy, flatten_colours(sure)
        )
        surface_mm = (
            solve_weighted_slopes(
                raise_walls(surface_mm, (gx, gy), sure, pixel_mm), (gx, gy), sure, pixel_mm, integrated, cg_steps
            )
            if light == "sure"
            else integrated(gx, gy)
        )
    return surface_mm, misfit


def flatten_colours(image: Floats) -> Floats:
    """An image (rows, cols, 3) as (rows, 3 cols), a view of it: a stride that is not written down is a slow one."""
    return image.reshape(len(image), -1)


def clip_surface(surface_mm: Floats, picture: ImagePatch, source: SensorSpec) -> Floats:
    """The surface (rows, cols) no farther out or in than the sensor's gel goes; at rest where nothing has moved."""
    return np.clip(surface_mm, _LEAST_MM, source.limits.indentation_max_mm) * picture.changed


def has_weak_shading(touched: Mask, still: Floats, source: SensorSpec) -> bool:
    """Whether a touch (rows, cols) lies where near lamps change the colours of `still` little, whatever its slope.

    The weakest direction counts, beside what it is in the middle of all places.
    """
    import cv2

    if not touched.any():
        return False
    table, change = near_led_prior.compute_gains(source), near_led_prior.compute_described_change(source)
    rows, cols = table.shape[:2]
    here = np.asarray(cv2.resize(still, (cols, rows), interpolation=cv2.INTER_AREA), np.float32)
    offset = np.float32(slope_model.OFFSET_GREY)
    bright = table * (here + offset) / (here.reshape(-1, 3).mean(axis=0) + offset)
    by_slope = bright[..., None] * change  # (rows, cols, colours, 2)
    least = np.linalg.eigvalsh(np.einsum("rcki,rckj->rcij", by_slope, by_slope))[..., 0]
    share = np.sqrt(np.maximum(least, 0.0) / max(float(np.median(least)), 1e-6)).astype(np.float32)
    full = np.asarray(cv2.resize(share, touched.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
    return float(np.median(full[touched])) < _HARDLY


def _brightness(source: SensorSpec, picture: ImagePatch, light: LightModel) -> Floats:
    """By how much each colour's light (rows, cols, 3) is stronger here than it is described.

    Paint, lens, exposure, and lamps that shine on a part of the gel make a place bright, and its change strong as well.
    """
    import cv2

    if light != "near":
        return np.ones_like(picture.reference)
    width = _BRIGHT_BLUR_PX / picture.downsampling
    here = np.asarray(cv2.GaussianBlur(picture.reference, (0, 0), width) if width > _NO_BLUR else picture.reference)
    offset = np.float32(slope_model.OFFSET_GREY)
    usual = compute_reference_light(source.camera, optics.require_optics(source)).reshape(-1, 3).mean(axis=0)
    return np.asarray((here + offset) / (usual + offset) * _gains(source, picture), np.float32)


def _gains(source: SensorSpec, picture: ImagePatch) -> Floats:
    """By how much near lamps' light changes more, beside the brightness, at the pixels (rows, cols, 3)."""
    import cv2

    table = near_led_prior.compute_gains(source)
    camera = source.camera
    x = picture.x_px * np.float32((table.shape[1] - 1) / (camera.cols - 1))
    y = picture.y_px * np.float32((table.shape[0] - 1) / (camera.rows - 1))
    wide, tall = np.meshgrid(x, y)
    return np.asarray(cv2.remap(table, wide, tall, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)


def compute_light_share(source: SensorSpec, surface_mm: Floats, pixel_mm: float) -> Floats:
    """The share of every colour's light (rows, cols, 3) that no dent keeps from a pixel."""
    share = np.ones((*surface_mm.shape, 3), np.float32)
    if optics.require_optics(source).shadow > 0:
        optics.apply_shadows(share, source, np.ascontiguousarray(surface_mm, np.float32), pixel_mm)
    return share


def simulate_recorded_change(change: Floats, source: SensorSpec, picture: ImagePatch) -> Floats:
    """What a camera records of a change of light (rows, cols, 3): `blurred`, and between black and white."""
    drawn = np.clip(blur_change(change, source, picture) + picture.reference, 0.0, 255.0)
    return np.asarray(drawn - picture.reference, np.float32)


def blur_change(change: Floats, source: SensorSpec, picture: ImagePatch) -> Floats:
    """Grey levels (rows, cols, 3) as the lens and the smoothing of `picture` leave them."""
    import cv2

    width = math.hypot(optics.require_optics(source).blur_px, picture.smoothing_px) / picture.downsampling
    return np.asarray(cv2.GaussianBlur(change, (0, 0), width), np.float32) if width > _NO_BLUR else change
