"""What an unknown source sensor could observe of an object: a window, a slice of its surface,
errors.

No source sensor is simulated. A gel observes what lies within a millimetre of the deepest point in
its window; a bubble observes far more, through a membrane that bridges dents and a camera that
blurs. A network trained on the whole range serves sources of which it has seen no pair.
"""

import math
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Mask, freeze
from pipeline.core.geometry.camera import Camera
from pipeline.sensors.spec import SensorSpec

_FAR_MM = 60.0  # behind the nearest point: no object
# ranges of half the width and height of gels' windows, at the rest surface
_GEL_HALF_MM = (6.0, 13.0), (4.5, 10.0)
_WINDOW_OFFSET_MM = 1.2  # standard deviation of a window's centre
# of a membrane and its depth camera
_MAX_BRIDGE_MM = 2.5
_MAX_BLUR_MM = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceObservation:
    """What a source observes; arrays (rows, cols) on the target's grid."""

    depth_mm: Floats  # z of the object's surface where it is observed, NaN elsewhere
    observed: Mask
    in_view: Mask  # the source's field of view


def simulate_source_observation(
    rng: np.random.Generator, surface_mm: Doubles, target: SensorSpec, *, gel_share: float
) -> SourceObservation:
    """The observation of an object whose z (rows, cols) in the target's camera is given, NaN =
    none.

    The source is a gel with probability `gel_share`, else a bubble, centred on the target's axis.
    Nothing is observed where the object is outside the window.
    """
    is_gel = rng.random() < gel_share
    pixel_mm = target.pixel_mm
    in_view = (
        _sample_window(rng, target.camera, pixel_mm)
        if is_gel
        else freeze(np.ones(surface_mm.shape, np.bool_))
    )
    measured = (
        _add_gel_errors(rng, surface_mm, pixel_mm)
        if is_gel
        else _add_bubble_errors(rng, surface_mm, pixel_mm)
    )
    observed = in_view & np.isfinite(surface_mm)
    if observed.any():
        slice_mm = (
            math.exp(rng.uniform(math.log(0.12), math.log(1.0)))
            if is_gel
            else rng.uniform(0.6, 8.0)
        )
        observed &= measured <= measured[observed].min() + slice_mm
    depth = np.where(observed, measured, np.float32(np.nan))
    return SourceObservation(depth_mm=freeze(depth), observed=freeze(observed), in_view=in_view)


def _sample_window(rng: np.random.Generator, camera: Camera, pixel_mm: float) -> Mask:
    y, x = np.mgrid[: camera.rows, : camera.cols] * pixel_mm
    half_x, half_y = (rng.uniform(*both) for both in _GEL_HALF_MM)
    offset_x, offset_y = rng.normal(0.0, _WINDOW_OFFSET_MM, 2)
    inside = np.abs(x - camera.cx_px * pixel_mm - offset_x) <= half_x
    return freeze(inside & (np.abs(y - camera.cy_px * pixel_mm - offset_y) <= half_y))


def _fill(surface_mm: Doubles) -> Floats:
    """The surface with no object far behind it."""
    return np.nan_to_num(
        surface_mm, nan=_FAR_MM + float(np.nanmin(surface_mm, initial=1e3))
    ).astype(np.float32)


def _add_gel_errors(rng: np.random.Generator, surface_mm: Doubles, pixel_mm: float) -> Floats:
    """Two in five are exact; the others are scaled along z and uneven."""
    near = _fill(surface_mm)
    if rng.random() < 0.4:
        return near
    top = float(near.min())
    uneven = np.float32(rng.uniform(0.0, 0.06)) * _sample_noise(
        rng, surface_mm.shape, pixel_mm, rng.uniform(1.0, 4.0)
    )
    return np.asarray(top + (near - top) * np.float32(rng.normal(1.0, 0.1)) + uneven, np.float32)


def _add_bubble_errors(rng: np.random.Generator, surface_mm: Doubles, pixel_mm: float) -> Floats:
    """Dents bridged, edges blurred, smooth noise and bias of a depth camera."""
    import cv2

    near = _fill(surface_mm)
    reach = round(rng.uniform(0.0, _MAX_BRIDGE_MM) / pixel_mm)
    near = np.minimum(near, near.min() + 12.0)
    if reach and rng.random() < 0.7:
        disc = np.asarray(
            cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
        )
        # A membrane comes from small z: it rests on the nearest points and spans narrow gaps behind
        # them.
        bridged = np.asarray(cv2.morphologyEx(near, cv2.MORPH_OPEN, disc), np.float32)
        near = near + np.float32(rng.uniform(0.0, 1.0)) * (bridged - near)
    sigma = rng.uniform(0.05, _MAX_BLUR_MM) / pixel_mm
    blurred = np.asarray(cv2.GaussianBlur(near, (0, 0), max(sigma, 0.3)), np.float32)
    noise = np.float32(rng.uniform(0.0, 0.2)) * _sample_noise(
        rng, near.shape, pixel_mm, rng.uniform(0.6, 1.2)
    )
    bias = np.float32(rng.uniform(0.0, 0.2)) * _sample_noise(
        rng, near.shape, pixel_mm, rng.uniform(4.0, 12.0)
    )
    return np.asarray(blurred + noise + bias + np.float32(rng.normal(0.0, 0.08)), np.float32)


def _sample_noise(
    rng: np.random.Generator, shape: tuple[int, ...], pixel_mm: float, grain_mm: float
) -> Floats:
    """Smooth noise (rows, cols) of about unit strength and a correlation length of `grain_mm`."""
    import cv2

    rows, cols = (max(3, math.ceil(n * pixel_mm / grain_mm)) for n in shape)
    coarse = rng.standard_normal((rows, cols)).astype(np.float32)
    return np.asarray(cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC), np.float32)
