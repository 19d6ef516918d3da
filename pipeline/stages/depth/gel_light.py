"""A gel's surface corrected by its own optics, where one look-up per pixel cannot do: cast shadows and lens blur.

A look-up knows a pixel's colour and place only. Where a dent stands between an LED and a pixel, that LED's light is
missing there, and the look-up reads the darkness as a slope; over a steep rim the lens blur flattens the slopes. Both
follow from the surface, so they are found together with it (analysis by synthesis). Each round renders the surface as
it is known so far, z, on the untouched picture R,

    light = (R + c(grad z)) s(z),    c: colour change of a slope, s: share of the light that gets past the surface,

compares the change of the blurred light with the change of the picture, steps from grad z to slopes that explain the
rest r (Gauss-Newton on every pixel, J = s dc/dg),

    dg = (J' W J + pull)^-1 J' W r,    W: Huber's weight of a colour, 0 where the camera sees nothing any more,

and integrates. What a pixel cannot say (a dark colour, light from one side) is left as the integration has it. The
look-up is only where the rounds start from, so that a coarse grid of it does.

Numbers without a source beside them are those that `benchmarks/depth_numbers.py` finds no better neighbour of: a third
less or half as much again changes the error by less than it does for the rounds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.calibration import slope_model
from pipeline.calibration.lookup import Calibration
from pipeline.calibration.markers import without_markers
from pipeline.physics import optics
from pipeline.sensors.spec import Markers, SensorSpec
from pipeline.stages.depth.moved import Window

_ROUNDS = 4  # two leave a fifth more error of a GelSlim, whose lights are low
_PULL = 500.0  # grey levels squared per unit slope squared: a colour in full light weighs a hundred times as much
_HUBER_GREY = 20.0  # larger misfits are dust, a reflection, or an optical description that is not this unit's
_STEEPEST = np.float32(1.43)  # mm/mm, 55 degrees: the light hardly changes beyond
_STEP = np.float32(0.01)  # mm/mm, of the difference quotients: a grey level or so, far above float32's rounding
_LEAST_MM = -0.5  # no gel bulges out farther
_FLANK, _FLANK_SHARE = 0.12, 0.1  # mm/mm, and of a region's pixels
_BORDER_SHARE = 0.3  # of the deepest region
_COARSE = 4  # pixels of the picture to one of the first guess


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """The part of a picture that is worked on."""

    rows: slice
    cols: slice
    change: Floats  # (rows, cols, 3) grey levels, smoothed
    still: Floats  # (rows, cols, 3) the untouched picture
    moved: Mask  # (rows, cols) where the surface is looked for
    smoothing_px: float  # of the change


def applies(source: SensorSpec, calibration: Calibration) -> bool:
    """Whether the sensor's description tells its optics, and the look-up came from that description.

    A look-up that was fitted to presses has their shadows and blur in it.
    """
    return source.optics is not None and calibration.is_built_in


def seen(
    image: Image, still: Floats, window: Window, smoothing_px: float, markers: Markers | None, pixel_mm: float
) -> Seen:
    """The window of a picture, ready for `corrected`; `still` is the untouched one, in its light.

    Printed markers, where they are now and where they were, are filled in from around them.
    """
    import cv2

    here = (window.rows, window.cols)
    light = np.ascontiguousarray(still[here])
    change = image[here].astype(np.float32) - light
    if markers is not None:
        change, light = without_markers(change, image[here], light, markers, pixel_mm)
    if smoothing_px > 0:
        change = np.asarray(cv2.GaussianBlur(change, (0, 0), smoothing_px), np.float32)
    return Seen(rows=window.rows, cols=window.cols, change=change, still=freeze(light), moved=window.moved,
                smoothing_px=smoothing_px)  # fmt: skip


def rough_slopes(picture: Seen, calibration: Calibration) -> tuple[Floats, Floats]:
    """What the look-up makes of the window, (gx, gy) in mm/mm, worked out on a coarse grid."""
    import cv2

    rows, cols = picture.moved.shape
    size = (-(-cols // _COARSE), -(-rows // _COARSE))

    def coarse(a: Floats, to: tuple[int, int]) -> Floats:
        return np.asarray(cv2.resize(a, to, interpolation=cv2.INTER_AREA), np.float32)

    u, v = slope_model.position((calibration.rows, calibration.cols))
    u, v = coarse(u[None, picture.cols], (size[0], 1))[0], coarse(v[picture.rows, None], (1, size[1]))[:, 0]
    change = coarse(picture.change * slope_model.gain(picture.still), size)
    everywhere = np.ones((size[1], size[0]), np.bool_)
    gx, gy = (
        np.asarray(cv2.resize(g, (cols, rows), interpolation=cv2.INTER_LINEAR), np.float32) * picture.moved
        for g in slope_model.evaluate(calibration.model, change, u, np.ascontiguousarray(v), everywhere)
    )
    return gx, gy


def corrected(
    surface_mm: Floats, picture: Seen, source: SensorSpec, integrated: Callable[[Floats, Floats], Floats]
) -> Floats:
    """The surface (rows, cols) of the window whose picture comes nearest to the one seen, from a first guess of it.

    `integrated` makes slopes (gx, gy) of the window a surface in mm. Needs a sensor that `applies`.
    """
    from pipeline.stages.depth.gel_light_kernels import explained

    for _ in range(_ROUNDS):
        z = np.clip(surface_mm, _LEAST_MM, source.limits.indentation_max_mm) * picture.moved
        gx, gy = optics.slopes(z, source.pixel_mm)
        light, by_x, by_y = _colours(source, gx, gy, picture)
        share = _passed(source, z)
        rest = picture.change - _blurred((picture.still + light) * share - picture.still, source, picture)
        explained(rest, picture.change, picture.still, share, by_x, by_y, picture.moved,
                  np.float32(_PULL), np.float32(_HUBER_GREY), _STEEPEST, gx, gy)  # fmt: skip
        surface_mm = integrated(gx, gy)
    return surface_mm


def pressed_in(touched: Mask, surface_mm: Floats, pixel_mm: float, border: Mask | None = None) -> Mask:
    """`touched` without the broad, shallow regions that drifting light leaves beside a touch; the deepest one stays.

    What presses has flanks: some of its region is steep. On the image's `border`, beyond which nothing holds the
    surface, it must be a good part as deep as the deepest too: the corners of a picture are where light is least known.
    """
    import cv2
    from scipy import ndimage

    n, found = cv2.connectedComponents(touched.astype(np.uint8), connectivity=8)
    if n <= 2:  # the background and one region
        return touched
    regions = np.asarray(found, np.int32)
    steep = np.hypot(*optics.slopes(surface_mm, pixel_mm)) > _FLANK
    keep = np.asarray(ndimage.mean(steep, regions, np.arange(n))) > _FLANK_SHARE
    depths = np.asarray(ndimage.maximum(surface_mm, regions, np.arange(1, n)))
    if border is not None:
        cut = np.unique(regions[touched & border])
        keep[cut[depths[cut - 1] < _BORDER_SHARE * float(depths.max())]] = False
    keep[1 + int(np.argmax(depths))] = True
    keep[0] = False
    return np.asarray(keep[regions], np.bool_)


def _colours(source: SensorSpec, gx: Floats, gy: Floats, picture: Seen) -> tuple[Floats, Floats, Floats]:
    """What the slopes add to the light (rows, cols, 3), and its rates of change with gx and gy."""
    here = (picture.rows, picture.cols)
    x, y = np.zeros(source.camera.shape, np.float32), np.zeros(source.camera.shape, np.float32)
    x[here], y[here] = gx, gy
    light = optics.colour_change(source, x, y)[here]
    by_x = (optics.colour_change(source, x + _STEP, y)[here] - light) / _STEP
    by_y = (optics.colour_change(source, x, y + _STEP)[here] - light) / _STEP
    return light, by_x, by_y


def _passed(source: SensorSpec, surface_mm: Floats) -> Floats:
    """The share of every colour's light (rows, cols, 3) that no dent keeps from a pixel."""
    share = np.ones((*surface_mm.shape, 3), np.float32)
    optics.shade(share, source, np.ascontiguousarray(surface_mm, np.float32))
    return share


def _blurred(change: Floats, source: SensorSpec, picture: Seen) -> Floats:
    import cv2

    width = math.hypot(optics.optics_of(source).blur_px, picture.smoothing_px)
    return np.asarray(cv2.GaussianBlur(change, (0, 0), width), np.float32) if width > 0 else change
