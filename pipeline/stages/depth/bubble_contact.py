"""Displacement and contact of a bubble's membrane, from its noisy depth.

Constants without a source have no better neighbour in a sweep (docs/experiments.md,
`depth_numbers`): a third less or half as much again changes the error by 1.3 % at most.
"""

import math

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import contact, membrane_load

_MEDIAN_PX = 5  # of the median that removes single outliers: the widest that OpenCV has for floats
SMOOTHING_MM = 1.25  # shorter waves of a taut membrane are smaller than a depth camera's noise
_CURVATURE_MM = 1.5
_CERTAIN_SHARE = 0.35  # of the peak pressure; with less, noise joins the contact
_CANDIDATE_SHARE = 0.15  # of the peak: leaves out 2 % of a contact at most
_SPECK_MM2 = 20.0  # of a smoothed region: noise alone makes smaller ones
_CANDIDATE_MARGIN_MM = 1.6
_WORKING_PIXELS_MAX = 25_000  # more would only resolve noise
# of the untouched membrane of soft_bubble.toml: pressure over tension; no result depends on its
# exact value
USUAL_CURVATURE_PER_MM = 0.027
_GAP_MM = 1.2  # of a contact, closed
_LOAD_MIN = 1.0  # times the inner pressure: a flat face carries 1, an edge 10 and more


def estimate_indentation(
    moved: Floats, seen: Mask, source: SensorSpec, *, smoothing_px: float, least_mm: float
) -> tuple[Floats, Mask]:
    """(indentation, contact) from a noisy displacement (rows, cols) in mm, finite everywhere,
    measured where `seen`.

    Curvature gives candidate regions; there the load on the membrane is estimated. Contact is where
    the load exceeds a multiple of the inner pressure and the membrane has moved by more than
    `least_mm`. `smoothing_px` multiplies the noise that is assumed: 1 as measured; 0 leaves the
    indentation unsmoothed.
    """
    noise_factor = smoothing_px if smoothing_px > 0 else 1.0
    smooth = denoise_displacement(moved, noise_factor * SMOOTHING_MM / source.pixel_mm)
    candidates = _detect_candidates(smooth, least_mm, source.pixel_mm)
    if candidates.any():
        smooth, touched = _solve_load(moved, seen, candidates, smooth, source, noise_factor)
    else:
        touched = candidates
    return (smooth if smoothing_px > 0 else moved), touched & (smooth > least_mm)


def denoise_displacement(raw: Floats, length_px: float) -> Floats:
    """The displacement without outliers (median), smoothed by min |u - raw|^2 + length^4 |lap u|^2.

    A membrane under tension has no kinks except at the edge of a contact, so bending is penalised;
    the minimum damps each cosine wave.
    """
    import cv2
    from scipy import fft

    if length_px <= 0:
        return raw
    filtered = np.asarray(cv2.medianBlur(raw, _MEDIAN_PX), np.float32)
    wave = np.asarray(fft.dctn(filtered, type=2, norm="ortho", workers=2))
    return np.asarray(
        fft.idctn(wave * _compute_damping(raw.shape, length_px), type=2, norm="ortho", workers=2),
        np.float32,
    )


@derive_once
def _compute_damping(shape: tuple[int, int], length_px: float) -> Floats:
    ky, kx = (np.arange(n) * (math.pi / n) for n in shape)
    q_sq = ky[:, None] ** 2 + kx[None, :] ** 2
    return freeze((1.0 / (1.0 + (length_px * length_px * q_sq) ** 2)).astype(np.float32))


def _detect_candidates(indentation: Floats, least_mm: float, pixel_mm: float) -> Mask:
    """Where the membrane may follow an object, with a margin; empty where no contact is certain.

    Between the object and the rim, a membrane under tension carries no load and is curved by the
    air alone; over a contact it is curved the other way. Curvature is computed at the scale of a
    few millimetres, above the noise.
    """
    import cv2

    smooth = max(1.0, _CURVATURE_MM / pixel_mm)
    speck = max(4, round(_SPECK_MM2 / pixel_mm**2))
    weak, strong = (
        contact.remove_specks(
            contact.detect_membrane_contact(
                indentation, least_mm=least_mm, pressure_share=share, smoothing_px=smooth
            ),
            speck,
        )
        for share in (_CANDIDATE_SHARE, _CERTAIN_SHARE)
    )
    weak = contact.select_seeded(weak, strong)
    disc = _make_disc(_CANDIDATE_MARGIN_MM / pixel_mm)
    return np.asarray(cv2.dilate(weak.astype(np.uint8), disc), np.bool_)


def _make_disc(radius_px: float) -> NDArray[np.uint8]:
    import cv2

    side = 2 * max(1, round(radius_px)) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)), np.uint8)


def _solve_load(
    moved: Floats,
    seen: Mask,
    candidates: Mask,
    smooth: Floats,
    source: SensorSpec,
    noise_factor: float,
) -> tuple[Floats, Mask]:
    """(indentation, contact) by `membrane_load`, on at most about `_WORKING_PIXELS_MAX` pixels."""
    import cv2

    shape = moved.shape
    by = math.ceil(math.sqrt(moved.size / _WORKING_PIXELS_MAX))
    small, small_seen, small_candidates, start = (
        contact.downsample(np.asarray(image, np.float32), by)
        for image in (moved, seen, candidates, smooth)
    )
    solution = membrane_load.estimate_load(
        small,
        small_seen > 0.5,
        small_candidates > 0.0,
        start,
        pixel_mm=source.pixel_mm * by,
        curvature_per_mm=USUAL_CURVATURE_PER_MM,
        noise_factor=noise_factor,
    )
    closed = cv2.morphologyEx(
        (solution.load > _LOAD_MIN).astype(np.float32),
        cv2.MORPH_CLOSE,
        _make_disc(_GAP_MM / (source.pixel_mm * by)),
    )
    touched = contact.upsample(np.asarray(closed, np.float32), shape) > 0.5
    return contact.upsample(solution.displacement_mm, shape), touched
