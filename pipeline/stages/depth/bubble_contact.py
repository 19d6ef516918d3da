"""What a bubble's noisy depth says: how far the membrane moved, and where something touches it.

Numbers without a source beside them are those that `benchmarks/depth_numbers.py` finds no better neighbour of: a third
less or half as much again changes the reading's error by 1.3 % at most.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.base.memo import memoise
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import contact, membrane_load

_SPECKLE_PX = 5  # of the median that removes single wrong readings: the widest that OpenCV has for floats
_SMOOTHED_MM = 1.25  # shorter waves of a taut membrane are lower than a depth camera's noise
_CURVATURE_MM = 1.5
_CERTAIN_SHARE = 0.35  # of the peak; with less, the noise joins the contact
_CANDIDATE_SHARE = 0.15  # of the peak: leaves out 2 % of a contact at most
_SPECK_MM2 = 20.0  # of a smoothed region: noise alone makes smaller ones
_AROUND_MM = 1.6
_MOST_PIXELS = 25_000  # more of them would be time spent on noise
_STANDS_OUT = 4.0  # times the noise of single readings
_STANDS_OUT_MM = 0.5
_USUAL_CURVATURE_PER_MM = 0.027  # that of soft_bubble.toml
_BLUR_MM = 0.28
_LOADED = 1.0  # times the pressure inside: a flat face bears 1, an edge 10 and more
_TORN_MM = 1.2
_ISLAND_MM2 = 2.0


def estimate_indentation(
    moved: Floats, seen: Mask, source: SensorSpec, *, smoothing_px: float, least_mm: float
) -> tuple[Floats, Mask]:
    """(indentation, contact) from a noisy move (rows, cols) in mm, finite everywhere, read where `seen`.

    A first look by curvature finds where a contact may be; a second asks there what presses on the membrane. Contact is
    where the load exceeds a multiple of the pressure inside, and the membrane has moved by more than `least_mm`.
    `smoothing_px` is 1 for the noise as it is; larger distrusts the readings, 0 leaves the indentation as it was read.
    """
    caution = smoothing_px if smoothing_px > 0 else 1.0
    smooth = denoise_displacement(moved, caution * _SMOOTHED_MM / source.pixel_mm)
    candidates = _candidates(smooth, least_mm, source.pixel_mm)
    if candidates.any():
        smooth, touched = _by_load(moved, seen, candidates, smooth, source, caution)
    else:
        touched = candidates
    return (smooth if smoothing_px > 0 else moved), touched & (smooth > least_mm)


def denoise_displacement(raw: Floats, length_px: float) -> Floats:
    """Single wrong readings out by a median, then the smoothing spline min |u - raw|^2 + length^4 |lap u|^2.

    A membrane under tension has no kinks but at the edge of a contact, so that bending is the right thing to punish;
    the minimum is a damping of each cosine wave.
    """
    import cv2
    from scipy import fft

    if length_px <= 0:
        return raw
    calm = np.asarray(cv2.medianBlur(raw, _SPECKLE_PX), np.float32)
    wave = np.asarray(fft.dctn(calm, type=2, norm="ortho", workers=2))
    return np.asarray(fft.idctn(wave * _damping(raw.shape, length_px), type=2, norm="ortho", workers=2), np.float32)


@memoise(8)
def _damping(shape: tuple[int, int], length_px: float) -> Floats:
    ky, kx = (np.arange(n) * (math.pi / n) for n in shape)
    q_sq = ky[:, None] ** 2 + kx[None, :] ** 2
    return freeze((1.0 / (1.0 + (length_px * length_px * q_sq) ** 2)).astype(np.float32))


def _candidates(indentation: Floats, least_mm: float, pixel_mm: float) -> Mask:
    """Where the membrane may follow an object, and somewhat around it; nothing where no contact is certain.

    Between the object and the rim a membrane under tension has no load to carry and is curved by the air alone; over a
    contact it is curved the other way. Curvature is only read at the scale of a few millimetres, above the noise.
    """
    import cv2

    smooth, speck = max(1.0, _CURVATURE_MM / pixel_mm), max(4, round(_SPECK_MM2 / pixel_mm**2))
    weak, strong = (
        contact.remove_specks(
            contact.detect_membrane_contact(indentation, least_mm=least_mm, pressure_share=share, smoothing_px=smooth),
            speck,
        )
        for share in (_CANDIDATE_SHARE, _CERTAIN_SHARE)
    )
    if not strong.any():
        return strong
    _, regions = cv2.connectedComponents(weak.astype(np.uint8), connectivity=8)
    regions = np.asarray(regions, np.int32)
    weak &= np.isin(regions, np.unique(regions[strong]))
    return np.asarray(cv2.dilate(weak.astype(np.uint8), _disc(_AROUND_MM / pixel_mm)), np.bool_)


def _by_load(
    moved: Floats, seen: Mask, candidates: Mask, smooth: Floats, source: SensorSpec, noise_factor: float
) -> tuple[Floats, Mask]:
    """(indentation, contact) by `membrane_load`, on fewer pixels where an image has more than the noise leaves."""
    rows, cols = moved.shape
    coarser = math.ceil(math.sqrt(rows * cols / _MOST_PIXELS))
    work_mm = source.pixel_mm * coarser
    found = membrane_load.estimate_load(
        *_coarser(moved, _plain(moved, seen), candidates, smooth, coarser),
        pixel_mm=work_mm, curvature_per_mm=_curvature_per_mm(source), noise_factor=noise_factor,
    )  # fmt: skip
    touched = _contact(found.load, work_mm)
    return _finer(found.displacement_mm, (rows, cols), cubic=True), _finer(
        touched.astype(np.float32), (rows, cols)
    ) > 0.5


def _plain(moved: Floats, seen: Mask) -> Mask:
    """The readings without those that stand out from around them: flying pixels and false matches."""
    import cv2

    out = np.abs(moved - np.asarray(cv2.medianBlur(moved, _SPECKLE_PX), np.float32))
    usual = 1.4826 * float(np.median(out[::3, ::3][seen[::3, ::3]])) if seen[::3, ::3].any() else 0.0
    return seen & (out <= max(_STANDS_OUT * usual, _STANDS_OUT_MM))


def _curvature_per_mm(source: SensorSpec) -> float:
    """How much the air curves the untouched membrane: pressure over tension. No figure depends on its exact value."""
    shape = source.bubble
    if shape is None or shape.height_mm <= 0:
        return _USUAL_CURVATURE_PER_MM
    return 2.0 * shape.height_mm * (shape.half_width_mm**-2 + shape.half_height_mm**-2)


def _contact(load: Floats, pixel_mm: float) -> Mask:
    """Where there is load; gaps that noise tears into it are closed, specks are dropped."""
    import cv2

    pressed = np.asarray(cv2.GaussianBlur(load, (0, 0), max(_BLUR_MM / pixel_mm, 0.5))) > _LOADED
    closed = cv2.morphologyEx(pressed.astype(np.uint8), cv2.MORPH_CLOSE, _disc(_TORN_MM / pixel_mm))
    return contact.remove_specks(np.asarray(closed, np.bool_), max(4, round(_ISLAND_MM2 / pixel_mm**2)))


def _disc(radius_px: float) -> NDArray[np.uint8]:
    import cv2

    side = 2 * max(1, round(radius_px)) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)), np.uint8)


def _coarser(moved: Floats, seen: Mask, candidates: Mask, smooth: Floats, by: int) -> tuple[Floats, Mask, Mask, Floats]:
    """Means over `by` x `by` pixels; what lies over the last whole block goes to its neighbours."""
    import cv2

    if by == 1:
        return moved, seen, candidates, smooth
    size = (max(1, round(moved.shape[1] / by)), max(1, round(moved.shape[0] / by)))
    images = (moved, smooth, seen.astype(np.float32), candidates.astype(np.float32))
    small = [np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32) for image in images]
    return small[0], small[2] > 0.5, small[3] > 0.0, small[1]


def _finer(image: Floats, shape: tuple[int, int], *, cubic: bool = False) -> Floats:
    import cv2

    if image.shape == shape:
        return image
    how = cv2.INTER_CUBIC if cubic else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, shape[::-1], interpolation=how), np.float32)
