"""Input of the network that estimates a bubble's depth: the displacement in parts of comparable
size.

A displacement of ten millimetres and its noise of a tenth do not fit one number of eight bits, so a
smooth estimate is subtracted, which the network corrects. Its curvature shows what air and contact
leave in it. The roughness of the reference is a channel as well: its noise is in the displacement a
second time, with the opposite sign.
"""

import numpy as np

from pipeline.calibration.contact_circles import find_largest_part
from pipeline.core.arrays import Floats, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.core.frozen import frozen
from pipeline.stages.depth.bubble_contact import (
    SMOOTHING_MM,
    USUAL_CURVATURE_PER_MM,
    denoise_displacement,
)

N_CHANNELS = 5
WORKING_PIXEL_MM = 0.406  # pixel width of the training data, within a third either way
_REST_SMOOTHING_MM = 5.0  # standard deviation of the mean that estimates the reference membrane
_ROUGHNESS_MM = 2.0  # shorter structure of a reference membrane is camera noise
_ROUGHNESS_MAX_MM = 1.5
# of the polynomial dome, and of the pixels it is fitted to
_DOME_DEGREE = 6
_DOME_STEP_PX = 4
_DOME_PIXELS_MIN = 64
# units of the channels
_COARSE_MM = 6.0
_FINE_MM = 0.5
_LOADS = 8.0
_CHANNEL_LIMIT = 4.0
_WEIGHT_MIN = np.float32(0.05)  # of the measured pixels around one in a mean


@frozen
class BubbleNetworkInput:
    """A displacement and its reference as the network's channels."""

    channels: Floats  # (N_CHANNELS, rows, cols)
    smooth_displacement_mm: Floats  # (rows, cols) the estimate that the network corrects


def make_network_input(
    moved_mm: Floats, rest_mm: Floats, seen: Mask, pixel_mm: float
) -> BubbleNetworkInput:
    """The channels of a displacement (rows, cols) from `rest_mm`.

    0 or filled in where not `seen`.
    """
    smooth = denoise_displacement(moved_mm, SMOOTHING_MM / pixel_mm)
    measured = seen.astype(np.float32)
    fine = (moved_mm - smooth) * measured
    channels = np.stack(
        [
            np.clip(fine, -_CHANNEL_LIMIT, _CHANNEL_LIMIT) / _FINE_MM,
            smooth / _COARSE_MM,
            _compute_load(smooth, pixel_mm),
            _compute_roughness(rest_mm, measured, pixel_mm) / _FINE_MM,
            measured,
        ]
    ).astype(np.float32)
    return BubbleNetworkInput(channels=freeze(channels), smooth_displacement_mm=freeze(smooth))


def _compute_load(smooth: Floats, pixel_mm: float) -> Floats:
    """The membrane's curvature (rows, cols) over that of a reference bubble, in units of
    `_LOADS`.
    """
    import cv2

    curvature = np.asarray(
        cv2.Laplacian(smooth, cv2.CV_32F, ksize=1, borderType=cv2.BORDER_REFLECT), np.float32
    )
    loads = curvature / np.float32(pixel_mm**2 * USUAL_CURVATURE_PER_MM * _LOADS)
    return np.clip(loads, -_CHANNEL_LIMIT, _CHANNEL_LIMIT).astype(np.float32)


def estimate_rest_surface(rest: Floats, seen: Mask, pixel_mm: float) -> Floats:
    """The reference membrane (rows, cols) without its noise: a dome plus structure wider than 10
    mm.
    """
    measured = seen.astype(np.float32)
    dome = _fit_dome(rest, measured)
    level = np.where(seen, rest - dome, np.float32(0.0)).astype(np.float32)
    return dome + _average(level, measured, _REST_SMOOTHING_MM / pixel_mm)


def _compute_roughness(rest: Floats, measured: Floats, pixel_mm: float) -> Floats:
    """Structure of a reference (rows, cols) too fine for a membrane.

    0 where nothing was measured.
    """
    level = np.where(measured > 0, rest - _fit_dome(rest, measured), np.float32(0.0)).astype(
        np.float32
    )
    rough = (level - _average(level, measured, _ROUGHNESS_MM / pixel_mm)) * measured
    return np.clip(rough, -_ROUGHNESS_MAX_MM, _ROUGHNESS_MAX_MM).astype(np.float32)


def _average(level: Floats, measured: Floats, sigma_px: float) -> Floats:
    """A Gaussian mean over the measured pixels; `level` is 0 elsewhere."""
    import cv2

    mean, share = (
        np.asarray(cv2.GaussianBlur(a, (0, 0), sigma_px), np.float32) for a in (level, measured)
    )
    return np.asarray(mean / np.maximum(share, _WEIGHT_MIN), np.float32)


@derive_once
def _fit_dome(rest: Floats, measured: Floats) -> Floats:
    """The polynomial of degree six nearest to a reference: an untouched dome in perspective, to
    hundredths of a mm.

    It is asked for twice with each frame, and by most of a recording's frames.
    """
    powers = [(i, j) for i in range(_DOME_DEGREE + 1) for j in range(_DOME_DEGREE + 1 - i)]
    y, x = (
        np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, n), _DOME_DEGREE)
        for n in rest.shape
    )
    sparse = slice(None, None, _DOME_STEP_PX)
    used = find_largest_part(measured > 0)[sparse, sparse]
    if np.count_nonzero(used) < _DOME_PIXELS_MIN:
        return freeze(np.zeros_like(rest))
    terms = np.stack(
        [(y[sparse, i][:, None] * x[sparse, j][None, :])[used] for i, j in powers], axis=-1
    )
    depth_mm = rest[sparse, sparse][used]
    shape = np.zeros((_DOME_DEGREE + 1, _DOME_DEGREE + 1))
    shape[tuple(np.transpose(powers))] = np.linalg.lstsq(terms, depth_mm, rcond=None)[0]
    return freeze((y @ shape @ x.T).astype(np.float32))
