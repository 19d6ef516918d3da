"""What some other sensor might tell of an object: a window, a thin slice of its surface, and a measurement's errors.

No source sensor is simulated. A gel feels what comes within a millimetre of the deepest point in a window of its own;
a bubble feels far more, through a membrane that bridges dents and a camera that blurs. A network that has seen all
between the two serves sources that it was never shown a pair of.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Mask, freeze
from pipeline.geometry.camera import Camera
from pipeline.sensors.spec import SensorSpec

_FAR_MM = 60.0  # behind the nearest point: nothing there
_GEL_HALF_MM = (6.0, 13.0), (4.5, 10.0)  # half widths and heights of gels' windows, at the target's rest surface
_ASIDE_MM = 1.2
_BRIDGED_MM, _BLUR_MM = 2.5, 0.8  # at most, by a membrane and its depth camera


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceObservation:
    """What a source tells, each (rows, cols) on the target's grid."""

    depth_mm: Floats  # z of the object's surface where it was felt, NaN elsewhere
    observed: Mask
    in_view: Mask  # where it would have been felt


def simulate_source_observation(
    rng: np.random.Generator, surface_mm: Doubles, target: SensorSpec, *, gel_share: float
) -> SourceObservation:
    """What one source, a gel in a share `as_gel` of all, tells of an object whose z (rows, cols) is given; NaN = none.

    The surface is that which `target` would see; straight ahead of it stands the source's middle. Nothing is felt where
    the object leaves the window free.
    """
    gel, pixel_mm = rng.random() < gel_share, target.pixel_mm
    known = _window(rng, target.camera, pixel_mm) if gel else freeze(np.ones(surface_mm.shape, np.bool_))
    measured = _through_gel(rng, surface_mm, pixel_mm) if gel else _through_bubble(rng, surface_mm, pixel_mm)
    there = known & np.isfinite(surface_mm)
    if not there.any():
        nowhere = freeze(np.zeros(known.shape, np.bool_))
        return SourceObservation(
            depth_mm=freeze(np.full(known.shape, np.nan, np.float32)), observed=nowhere, in_view=known
        )
    slice_mm = math.exp(rng.uniform(math.log(0.12), math.log(1.0))) if gel else rng.uniform(0.6, 8.0)
    felt = there & (measured <= measured[there].min() + slice_mm)
    return SourceObservation(
        depth_mm=freeze(np.where(felt, measured, np.float32(np.nan))), observed=freeze(felt), in_view=known
    )


def _window(rng: np.random.Generator, camera: Camera, pixel_mm: float) -> Mask:
    y, x = np.mgrid[: camera.rows, : camera.cols] * pixel_mm
    half_x, half_y = (rng.uniform(*both) for both in _GEL_HALF_MM)
    aside_x, aside_y = rng.normal(0.0, _ASIDE_MM, 2)
    inside = np.abs(x - camera.cx_px * pixel_mm - aside_x) <= half_x
    return freeze(inside & (np.abs(y - camera.cy_px * pixel_mm - aside_y) <= half_y))


def _through_gel(rng: np.random.Generator, surface_mm: Doubles, pixel_mm: float) -> Floats:
    """Too deep or too flat, and uneven; every other one exact."""
    near = np.nan_to_num(surface_mm, nan=_FAR_MM + float(np.nanmin(surface_mm, initial=1e3))).astype(np.float32)
    if rng.random() < 0.4:
        return near
    top = float(near.min())
    uneven = np.float32(rng.uniform(0.0, 0.06)) * _clouds(rng, surface_mm.shape, pixel_mm, rng.uniform(1.0, 4.0))
    return np.asarray(top + (near - top) * np.float32(rng.normal(1.0, 0.1)) + uneven, np.float32)


def _through_bubble(rng: np.random.Generator, surface_mm: Doubles, pixel_mm: float) -> Floats:
    """Dents bridged, edges blurred, the noise of a depth camera that was smoothed."""
    import cv2

    near = np.nan_to_num(surface_mm, nan=_FAR_MM + float(np.nanmin(surface_mm, initial=1e3))).astype(np.float32)
    reach = round(rng.uniform(0.0, _BRIDGED_MM) / pixel_mm)
    near = np.minimum(near, near.min() + 12.0)
    if reach and rng.random() < 0.7:
        disc = np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1)))
        # A membrane comes from small z: it rests on what is nearest and spans what is narrow behind it.
        spanned = np.asarray(cv2.morphologyEx(near, cv2.MORPH_OPEN, disc), np.float32)
        near = near + np.float32(rng.uniform(0.0, 1.0)) * (spanned - near)
    sigma = rng.uniform(0.05, _BLUR_MM) / pixel_mm
    blurred = np.asarray(cv2.GaussianBlur(near, (0, 0), max(sigma, 0.3)), np.float32)
    noise = np.float32(rng.uniform(0.0, 0.2)) * _clouds(rng, near.shape, pixel_mm, rng.uniform(0.6, 1.2))
    bias = np.float32(rng.uniform(0.0, 0.2)) * _clouds(rng, near.shape, pixel_mm, rng.uniform(4.0, 12.0))
    return np.asarray(blurred + noise + bias + np.float32(rng.normal(0.0, 0.08)), np.float32)


def _clouds(rng: np.random.Generator, shape: tuple[int, ...], pixel_mm: float, grain_mm: float) -> Floats:
    """Noise (rows, cols) of about unit strength whose grains are that wide."""
    import cv2

    rows, cols = (max(3, math.ceil(n * pixel_mm / grain_mm)) for n in shape)
    coarse = rng.standard_normal((rows, cols)).astype(np.float32)
    return np.asarray(cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC), np.float32)
