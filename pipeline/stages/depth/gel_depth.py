"""Depth of a gel: colour change -> slopes -> surface, worked out only around what has moved.

Where the sensor's description says what casts shadows, the surface is then corrected by it (`gel_light`).

Numbers without a source beside them are those that `benchmarks/depth_numbers.py` finds no better neighbour of, a third
less or half as much again: the best of these take 3 % off the error, the worst add 9 %.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.base.errors import CalibrationError, ShapeError
from pipeline.base.progress import Progress
from pipeline.calibration.lookup import Calibration, check_for, slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import contact, gel_light
from pipeline.stages.depth.poisson import Boundary, integrate
from pipeline.values.frames import TactileFrame
from pipeline.values.pixel_index import pixel_index
from pipeline.values.results import DepthMap

_BLOCK_PX = 8  # changes are looked for in blocks of this width
_GROWS_FROM = 0.35  # share of the no-touch limit down to which a touched region is followed outward
_DRIFT_FACTOR = 2.5  # times the picture's typical change, above which a block is part of a touch
_FADES_FROM, _GONE_AT = 0.2, 0.6  # thicknesses from the contact, see `_relaxed`
_SATURATED_GREY = 254  # noise of a grey level takes what is clipped at 255 down to here
_PRESSURE_BLUR_PX = 1.5
_SPECK_MM2 = 0.15  # smaller contacts are camera noise


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reach:
    """How far a touch is followed."""

    margin_mm: float  # beyond the last visible change: the gel relaxes to nothing within about this distance
    typical: float  # quantile of the blocks' changes that stands for what the whole picture does
    fills: bool  # what a touch encloses belongs to it: a flat face changes no colours, but it is not at rest


_NEAR = _Reach(margin_mm=1.0, typical=0.5, fills=False)
# With the light modelled, the bulge around a touch is measured too, and a touch may fill most of the picture.
_FAR = _Reach(margin_mm=2.0, typical=0.25, fills=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Window:
    """The part of the image that is worked on."""

    rows: slice
    cols: slice
    moved: Mask  # (rows, cols) of the window: where the picture has changed


def largest_change(image: Image, reference: Image) -> float:
    """Largest mean absolute change of a block of 8 x 8 pixels, in grey levels; infinite if the image is black."""
    blocks = _block_change(image, reference)
    return float(blocks.max()) if int(image.max()) > 2 else math.inf


def _block_change(image: Image, reference: Image) -> Image:
    """Mean absolute change of every whole block (rows // 8, cols // 8, 3), rounded; the last few pixels are dropped."""
    import cv2

    rows, cols = (n // _BLOCK_PX for n in image.shape[:2])
    inside = (slice(0, rows * _BLOCK_PX or None), slice(0, cols * _BLOCK_PX or None))
    change = cv2.absdiff(image[inside], reference[inside])
    size = (max(1, cols), max(1, rows))
    if not (rows and cols):  # smaller than a block
        return np.asarray(cv2.resize(change, size, interpolation=cv2.INTER_AREA), np.uint8)
    # Sums of eight rows first: the same numbers (all exact until they are rounded) in half the time.
    tall = np.add.reduce(change.reshape(rows, _BLOCK_PX, -1), axis=1, dtype=np.uint16).astype(np.float32)
    means = np.asarray(cv2.resize(tall.reshape(rows, -1, 3), size, interpolation=cv2.INTER_AREA), np.float32)
    return np.rint(means * np.float32(1 / _BLOCK_PX)).astype(np.uint8)


def depth(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration,
    *,
    no_touch_grey: float,
    least_mm: float,
    pressure_share: float,
    smoothing_px: float,
    boundary: Boundary,
    progress: Progress,
) -> DepthMap:
    """The depth of one gel picture, see `pipeline.stages.depth.depth`; the frame has been checked there."""
    image, reference = cast("Image", frame.image), cast("Image | None", frame.reference)
    if reference is None:
        raise ShapeError("a gel's depth needs a reference image")
    check_for(calibration, source.name, image)
    shape = source.camera.shape
    indentation, touched = np.zeros(shape, np.float32), np.zeros(shape, np.bool_)
    notes: list[str] = []
    modelled = gel_light.applies(source, calibration)
    window = _window(image, reference, no_touch_grey, calibration.pixel_mm, _FAR if modelled else _NEAR)
    if window is None:
        notes.append("nothing touches the sensor")
    else:
        here = (window.rows, window.cols)
        notes += _doubts(image[here], source, window)
        picture = gel_light.seen(image, reference, *here, window.moved, smoothing_px) if modelled else None
        if picture is not None:
            gx, gy = gel_light.rough_slopes(picture, calibration)
        else:
            gx, gy = slopes(
                calibration, image[here], reference[here], window.moved, (window.rows.start, window.cols.start),
                markers=source.markers, smoothing_px=smoothing_px,
            )  # fmt: skip
        if not math.isfinite(float(gx.sum()) + float(gy.sum())):
            raise CalibrationError(f"the look-up of {source.name} gives slopes that are no numbers; calibrate again")
        progress.step(0.5, "integrating slopes")

        def integrated(x: Floats, y: Floats) -> Floats:
            return _surface(x, y, window, calibration.pixel_mm, boundary, shape)

        surface = integrated(gx, gy)
        if picture is not None:
            surface = gel_light.corrected(surface, picture, source, integrated)
        speck = max(4, round(_SPECK_MM2 / calibration.pixel_mm**2))
        pressed = contact.touched(
            surface, least_mm=least_mm, pressure_share=pressure_share, smoothing_px=_PRESSURE_BLUR_PX
        )
        pressed = contact.without_specks(pressed & window.moved, speck)
        touched[here] = gel_light.pressed_in(pressed, surface, calibration.pixel_mm) if modelled else pressed
        indentation[here] = _relaxed(surface, touched[here], source, calibration.pixel_mm) * window.moved
        notes += _limits(indentation, touched, source.limits.indentation_max_mm, least_mm)
    progress.step(1.0, "depth is ready")
    return DepthMap(
        indentation_mm=freeze(indentation),
        depth_mm=freeze((source.rest_depth_mm - indentation).astype(np.float32)),
        contact=freeze(touched),
        camera=source.camera,
        source_index=pixel_index(shape),
        notes=tuple(notes),
    )


def _window(image: Image, reference: Image, no_touch_grey: float, pixel_mm: float, reach: _Reach) -> _Window | None:
    """The box around everything that has changed, grown by the gel's relaxation; None where nothing has."""
    import cv2
    from scipy import ndimage

    blocks = _block_change(image, reference).max(axis=2).astype(np.float32)
    # A touch is not followed into what the whole picture does (drift of the light).
    low = max(_GROWS_FROM * no_touch_grey, _DRIFT_FACTOR * float(np.quantile(blocks, reach.typical)))
    if float(blocks.max()) < low:  # all of it has changed alike: a touch larger than the picture
        low = no_touch_grey
    n, regions = cv2.connectedComponents((blocks > low).astype(np.uint8), connectivity=8)
    strong = np.zeros(n, np.bool_)
    strong[np.unique(regions[blocks >= max(no_touch_grey, low)])] = True
    strong[0] = False
    if not strong.any():
        return None
    rows, cols = image.shape[:2]
    grow = 2 * math.ceil(reach.margin_mm / pixel_mm / _BLOCK_PX) + 1
    moved = cv2.dilate(strong[regions].astype(np.uint8), np.ones((grow, grow), np.uint8))
    if reach.fills:
        moved = np.asarray(ndimage.binary_fill_holes(moved), np.uint8)
    tall, wide = moved.shape[0] * _BLOCK_PX, moved.shape[1] * _BLOCK_PX
    full = cv2.resize(moved, (wide, tall), interpolation=cv2.INTER_NEAREST)[:rows, :cols].astype(np.bool_)
    full = np.pad(full, ((0, max(0, rows - tall)), (0, max(0, cols - wide))), "edge")
    r, c = np.flatnonzero(full.any(axis=1)), np.flatnonzero(full.any(axis=0))
    edge = _BLOCK_PX
    box = (
        slice(max(0, int(r[0]) - edge), min(rows, int(r[-1]) + edge + 1)),
        slice(max(0, int(c[0]) - edge), min(cols, int(c[-1]) + edge + 1)),
    )
    return _Window(rows=box[0], cols=box[1], moved=np.ascontiguousarray(full[box]))


def _doubts(part: Image, source: SensorSpec, window: _Window) -> list[str]:
    """What is said about slopes that the picture does not show."""
    notes: list[str] = []
    if source.markers is not None:
        notes.append("slopes under the printed markers were filled in from around them")
    clipped = (part >= _SATURATED_GREY).any(axis=2) & window.moved
    if clipped.sum() > 0.01 * window.moved.sum():
        notes.append(f"{int(clipped.sum())} pixels are saturated: slopes there are doubtful")
    return notes


def _surface(
    gx: Floats, gy: Floats, window: _Window, pixel_mm: float, boundary: Boundary, shape: tuple[int, int]
) -> Floats:
    """The integrated indentation of the window, level at its rest outside what has moved.

    A touch at the image border is mirrored there: the gel beyond is not seen, and not known to be at rest.
    """
    pad_rows = (gx.shape[0] if window.rows.start == 0 else 0, gx.shape[0] if window.rows.stop >= shape[0] else 0)
    pad_cols = (gx.shape[1] if window.cols.start == 0 else 0, gx.shape[1] if window.cols.stop >= shape[1] else 0)
    if boundary == "free" or (all(pad_rows) and all(pad_cols)):
        z = integrate(gx, gy, pixel_mm, "free")
    else:
        widths = (_one(pad_rows), _one(pad_cols))
        x = np.pad(np.pad(gx, (widths[0], (0, 0)), "symmetric"), ((0, 0), widths[1]), "symmetric")
        y = np.pad(gy, widths, "symmetric")
        _negate_mirrored(x, widths[1], 1)
        _negate_mirrored(y, widths[0], 0)
        z = integrate(np.ascontiguousarray(x), np.ascontiguousarray(y), pixel_mm, "flat")
        z = z[widths[0][0] : z.shape[0] - widths[0][1], widths[1][0] : z.shape[1] - widths[1][1]]
    outside = ~window.moved
    level = float(np.median(z[outside])) if outside.any() else float(z.min())
    return np.ascontiguousarray(z - np.float32(level))


def _relaxed(surface: Floats, touched: Mask, source: SensorSpec, pixel_mm: float) -> Floats:
    """The surface without what cannot be the gel's doing.

    Beside a contact a nearly incompressible layer of thickness t, bonded to its back, falls to its rest within about
    t / 2 and then bulges out a little: what the integration leaves there is drift. It fades out between t / 5 and
    3 t / 5 from the contact, and it is not let out beyond its rest.
    """
    import cv2

    if source.gel is None:
        return surface
    away = cv2.distanceTransform((~touched).astype(np.uint8), cv2.DIST_L2, 5)
    thicknesses = np.asarray(away, np.float32) * np.float32(pixel_mm / source.gel.thickness_mm)
    keep = np.clip((_GONE_AT - thicknesses) / (_GONE_AT - _FADES_FROM), 0.0, 1.0)
    if not touched.any():
        keep = np.zeros_like(surface)
    return np.asarray(np.maximum(surface, 0.0) * keep, np.float32)


def _one(pad: tuple[int, int]) -> tuple[int, int]:
    return pad if not all(pad) else (pad[0], 0)


def _negate_mirrored(g: Floats, width: tuple[int, int], axis: int) -> None:
    """The slope across a mirror changes its sign behind it."""
    view = np.moveaxis(g, axis, 0)
    view[: width[0]] *= -1.0
    if width[1]:
        view[-width[1] :] *= -1.0


def _limits(indentation: Floats, touched: Mask, largest_mm: float, least_mm: float) -> list[str]:
    """Bring the indentation within the sensor's reach, and say what was brought."""
    notes: list[str] = []
    beyond = indentation > largest_mm
    if beyond.any():
        notes.append(f"{int(beyond.sum())} pixels were deeper than the sensor's {largest_mm:g} mm and were cut to that")
        np.minimum(indentation, np.float32(largest_mm), out=indentation)
    quiet = (np.abs(indentation) < least_mm) & ~touched
    indentation[quiet] = 0.0
    edge = np.concatenate([touched[0], touched[-1], touched[:, 0], touched[:, -1]])
    if edge.any():
        notes.append("the contact reaches the image border: what lies beyond is not seen")
    if not touched.any():
        notes.append("the picture has changed, but nothing presses hard enough to be a contact")
    return notes
