"""Where a gel is touched, from how it is pushed in.

A surface moves beyond the contact too (Hertz: at the contact's edge by half of the largest indentation, on a thin
bonded layer by less), so no limit on depth separates touched from moved. Pressure does: it is zero outside. A pressure
wave of wavenumber q moves an elastic half-space by U(q) = 2 P(q) / (E* q), hence P(q) ~ q U(q), which is no rougher
than a slope. A layer bonded to a plate answers alike except to waves longer than its thickness; leaving that out shifts
the pressure by a smooth amount, which a limit at a share of the peak forgives: a share s finds a Hertz contact's radius
short by 1 - sqrt(1 - s^2), and neither the thickness of the gel nor its stiffness is needed.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal

import numpy as np

from pipeline.arrays import Floats, Mask, freeze

_WORKERS = 2
_SPECK_SHARE = 0.05  # of the largest region: dust and scratches that the press has shifted
_ENCLOSED_SHARE = 0.9  # of the depth of its rim: what is enclosed and as deep as that is touched as well


def relative_pressure(indentation_mm: Floats, smoothing_px: float, order: Literal[1, 2] = 1) -> Floats:
    """Pressure (rows, cols) up to a constant factor, without its longest waves; negative where the surface hangs free.

    `order` is the power of the wavenumber: 1 for an elastic gel, 2 for a membrane under tension, which carries a
    load by its curvature alone.

    The image is mirrored at its border (cosine transform), as if the touch went on beyond it.
    """
    from scipy import fft

    wave = np.asarray(fft.dctn(indentation_mm, type=2, norm="ortho", workers=_WORKERS))
    wave = wave * _wavenumbers(*indentation_mm.shape, smoothing_px, order)
    return np.asarray(fft.idctn(wave, type=2, norm="ortho", workers=_WORKERS), np.float32)


def touched(
    indentation_mm: Floats, *, least_mm: float, pressure_share: float, smoothing_px: float, order: Literal[1, 2] = 1
) -> Mask:
    """The contact (rows, cols): pushed in by `least_mm` or more, and pressed by more than a share of the region's peak.

    Each region that is pushed in has its own peak, so that a light touch beside a firm one is kept. A flat face carries
    its pressure along its rim; what the rim encloses is touched as well where it is as deep as the rim.
    """
    import cv2
    from scipy import ndimage

    deep = indentation_mm > least_mm
    if not deep.any():
        return deep
    n, found = cv2.connectedComponents(deep.astype(np.uint8), connectivity=8)
    regions = np.asarray(found, np.int32)
    pressure = relative_pressure(indentation_mm, smoothing_px, order)
    peaks = np.asarray(ndimage.maximum(pressure, regions, np.arange(n)))
    limit = (np.maximum(peaks, 1e-9) * pressure_share).astype(np.float32)[regions]
    mask = deep & (pressure > limit)
    enclosed = np.asarray(ndimage.binary_fill_holes(mask)) & ~mask
    if enclosed.any():
        m, found = cv2.connectedComponents(enclosed.astype(np.uint8), connectivity=4)
        holes = np.asarray(found, np.int32)
        grown = np.asarray(ndimage.grey_dilation(holes, size=(3, 3)))
        rim = np.where(mask, grown, 0)
        index = np.arange(m)
        inside = np.asarray(ndimage.mean(indentation_mm, holes, index))
        around = np.asarray(ndimage.mean(indentation_mm, rim, index))
        full = inside >= _ENCLOSED_SHARE * around
        full[0] = False
        mask |= full[holes]
    return mask


def without_specks(mask: Mask, min_pixels: int) -> Mask:
    """The mask without regions of fewer than `min_pixels` pixels or 5 % of the largest region."""
    import cv2

    n, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    keep = np.zeros(n, np.bool_)
    areas = stats[1:, cv2.CC_STAT_AREA]
    keep[1:] = areas >= max(min_pixels, _SPECK_SHARE * int(areas.max(initial=0)))
    return keep[np.asarray(labels, np.int32)]


@lru_cache(maxsize=64)
def _wavenumbers(rows: int, cols: int, smoothing_px: float, order: Literal[1, 2]) -> Floats:
    """Wavenumbers (rows, cols) of a cosine transform to the power of `order`, radians per pixel, damped by a blur."""
    ky, kx = (np.arange(n) * (math.pi / n) for n in (rows, cols))
    q_sq = ky[:, None] ** 2 + kx[None, :] ** 2
    return freeze((q_sq ** (0.5 * order) * np.exp(-0.5 * smoothing_px**2 * q_sq)).astype(np.float32))
