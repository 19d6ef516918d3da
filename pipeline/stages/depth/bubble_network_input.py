"""What the network of a bubble's reading is shown: a noisy move in parts that a network of few bits can tell apart.

A move of ten millimetres and its noise of a tenth do not fit one number of eight bits, so that a smooth estimate is
taken out: the network corrects it. Its curvature is what the air and the contact leave in it. The untouched reading's
own roughness is shown as well: what of it is noise stands in the move a second time, with the other sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.stages.depth.bubble_contact import denoise_displacement

N_CHANNELS = 5
WORKING_PIXEL_MM = 0.406  # width of the pixels that the network was taught on, within a third either way
_SMOOTHED_MM = 1.25
_CALM_MM = 5.0  # of the mean that a reading of the untouched membrane is taken for
_ROUGH_MM = 2.0  # what is rougher than this on an untouched membrane is the camera's
_MOST_ROUGH_MM = 1.5
_USUAL_CURVATURE_PER_MM = 0.027  # of an untouched bubble: pressure over tension
_ORDER, _SPARSE, _FEWEST = 6, 4, 64  # of the dome's shape, and of the pixels that it is fitted to
_COARSE_MM, _FINE_MM, _LOADS = 6.0, 0.5, 8.0  # units of the channels


@dataclass(frozen=True, slots=True, kw_only=True)
class BubbleNetworkInput:
    """A move and its reference as a network reads them."""

    channels: Floats  # (CHANNELS, rows, cols)
    smooth_displacement_mm: Floats  # (rows, cols) the estimate of the move that it corrects


def make_network_input(moved_mm: Floats, rest_mm: Floats, seen: Mask, pixel_mm: float) -> BubbleNetworkInput:
    """The channels of a move `moved_mm` (rows, cols), 0 or filled in where nothing was `seen`, from `rest_mm`."""
    smooth = denoise_displacement(moved_mm, _SMOOTHED_MM / pixel_mm)
    read = seen.astype(np.float32)
    fine = (moved_mm - smooth) * read
    picture = np.stack([
        np.clip(fine, -4.0, 4.0) / _FINE_MM, smooth / _COARSE_MM, _load(smooth, pixel_mm),
        _roughness(rest_mm, read, pixel_mm) / _FINE_MM, read,
    ]).astype(np.float32)  # fmt: skip
    return BubbleNetworkInput(channels=freeze(picture), smooth_displacement_mm=freeze(smooth))


def _load(smooth: Floats, pixel_mm: float) -> Floats:
    """What bends the membrane (rows, cols), in parts of what the air bends it by."""
    import cv2

    bend = np.asarray(cv2.Laplacian(smooth, cv2.CV_32F, ksize=1, borderType=cv2.BORDER_REFLECT), np.float32)
    loads = bend / np.float32(pixel_mm**2 * _USUAL_CURVATURE_PER_MM * _LOADS)
    return np.clip(loads, -4.0, 4.0).astype(np.float32)


def estimate_rest_surface(rest: Floats, seen: Mask, pixel_mm: float) -> Floats:
    """The untouched membrane (rows, cols) behind a noisy reading of it: a dome, and what is wider than 10 mm on it."""
    read = seen.astype(np.float32)
    bowl = _bowl(rest, read)
    return bowl + _mean(np.where(seen, rest - bowl, np.float32(0.0)).astype(np.float32), read, _CALM_MM / pixel_mm)


def _roughness(rest: Floats, read: Floats, pixel_mm: float) -> Floats:
    """What of an untouched reading (rows, cols) no membrane can be; 0 where nothing was read."""
    level = np.where(read > 0, rest - _bowl(rest, read), np.float32(0.0)).astype(np.float32)
    rough = (level - _mean(level, read, _ROUGH_MM / pixel_mm)) * read
    return np.clip(rough, -_MOST_ROUGH_MM, _MOST_ROUGH_MM).astype(np.float32)


def _mean(level: Floats, read: Floats, sigma_px: float) -> Floats:
    """A Gaussian mean of what was read; `level` is 0 elsewhere."""
    import cv2

    mean, share = (np.asarray(cv2.GaussianBlur(a, (0, 0), sigma_px), np.float32) for a in (level, read))
    return np.asarray(mean / np.maximum(share, np.float32(0.05)), np.float32)


def _bowl(rest: Floats, read: Floats) -> Floats:
    """The surface of sixth order nearest to a reading: an untouched dome in perspective, to hundredths of a mm."""
    powers = [(i, j) for i in range(_ORDER + 1) for j in range(_ORDER + 1 - i)]
    y, x = (np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, n), _ORDER) for n in rest.shape)
    some = read[::_SPARSE, ::_SPARSE] > 0
    if np.count_nonzero(some) < _FEWEST:
        return np.zeros_like(rest)
    terms = np.stack([(y[::_SPARSE, i][:, None] * x[::_SPARSE, j][None, :])[some] for i, j in powers], axis=-1)
    shape = np.zeros((_ORDER + 1, _ORDER + 1))
    shape[tuple(np.transpose(powers))] = np.linalg.lstsq(terms, rest[::_SPARSE, ::_SPARSE][some], rcond=None)[0]
    return (y @ shape @ x.T).astype(np.float32)
