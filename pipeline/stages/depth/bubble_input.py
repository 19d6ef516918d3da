"""What the network of a bubble's reading is shown: a noisy move in parts that a network of few bits can tell apart.

A move of ten millimetres and its noise of a tenth do not fit one number of eight bits, so that a smooth estimate is
taken out: the network corrects it. Its curvature is what the air and the contact leave in it. The untouched reading's
own roughness is shown as well: what of it is noise stands in the move a second time, with the other sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.stages.depth.bubble_reading import denoised

CHANNELS = 5
WORK_MM = 0.43  # width of the pixels that the network was taught on, within a third either way
_SMOOTHED_MM = 1.25
_ROUGH_MM = 2.0  # what is rougher than this on an untouched membrane is the camera's
_MOST_ROUGH_MM = 1.5
_USUAL_CURVATURE_PER_MM = 0.027  # of an untouched bubble: pressure over tension
_COARSE_MM, _FINE_MM, _LOADS = 6.0, 0.5, 8.0  # units of the channels


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """A move and its reference as a network reads them."""

    picture: Floats  # (CHANNELS, rows, cols)
    smooth_mm: Floats  # (rows, cols) the estimate of the move that it corrects


def shown(moved_mm: Floats, rest_mm: Floats, seen: Mask, pixel_mm: float) -> Shown:
    """The channels of a move `moved_mm` (rows, cols), 0 or filled in where nothing was `seen`, from `rest_mm`."""
    smooth = denoised(moved_mm, _SMOOTHED_MM / pixel_mm)
    read = seen.astype(np.float32)
    fine = (moved_mm - smooth) * read
    picture = np.stack([
        np.clip(fine, -4.0, 4.0) / _FINE_MM, smooth / _COARSE_MM, _load(smooth, pixel_mm),
        _roughness(rest_mm, read, pixel_mm) / _FINE_MM, read,
    ]).astype(np.float32)  # fmt: skip
    return Shown(picture=freeze(picture), smooth_mm=freeze(smooth))


def _load(smooth: Floats, pixel_mm: float) -> Floats:
    """What bends the membrane (rows, cols), in parts of what the air bends it by."""
    import cv2

    bend = np.asarray(cv2.Laplacian(smooth, cv2.CV_32F, ksize=1, borderType=cv2.BORDER_REFLECT), np.float32)
    return np.clip(bend / np.float32(pixel_mm**2 * _USUAL_CURVATURE_PER_MM * _LOADS), -4.0, 4.0).astype(np.float32)


def _roughness(rest: Floats, read: Floats, pixel_mm: float) -> Floats:
    """What of an untouched reading (rows, cols) no membrane can be; 0 where nothing was read."""
    import cv2

    level = np.where(read > 0, rest - _bowl(rest, read), np.float32(0.0)).astype(np.float32)
    sigma = _ROUGH_MM / pixel_mm
    mean, share = (np.asarray(cv2.GaussianBlur(a, (0, 0), sigma), np.float32) for a in (level, read))
    rough = (level - mean / np.maximum(share, np.float32(0.05))) * read
    return np.clip(rough, -_MOST_ROUGH_MM, _MOST_ROUGH_MM)


def _bowl(rest: Floats, read: Floats) -> Floats:
    """The quadric nearest to a reading: an untouched dome to a few tenths of a millimetre."""
    rows, cols = rest.shape
    y, x = np.linspace(-1.0, 1.0, rows, dtype=np.float32), np.linspace(-1.0, 1.0, cols, dtype=np.float32)

    def terms(at_y: Floats, at_x: Floats) -> Floats:
        u, v = np.broadcast_arrays(at_x[None, :], at_y[:, None])
        return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v, u * u * u * u, v * v * v * v, u * u * v * v], -1)

    some, weight = rest[::4, ::4], read[::4, ::4].ravel() > 0
    if np.count_nonzero(weight) < 64:
        return np.zeros_like(rest)
    found = np.linalg.lstsq(terms(y[::4], x[::4]).reshape(-1, 9)[weight], some.ravel()[weight], rcond=None)[0]
    return (terms(y, x) @ found.astype(np.float32)).astype(np.float32)
