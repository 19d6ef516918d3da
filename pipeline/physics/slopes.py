"""Slopes of height images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats


def slopes(height_mm: NDArray[np.floating], pixel_mm: float) -> tuple[Floats, Floats]:
    """(d/dx, d/dy) in mm/mm of height images (..., rows, cols): central differences, one-sided at the border."""
    height = np.ascontiguousarray(height_mm, np.float32)
    per_px = np.float32(1.0) / np.float32(pixel_mm)
    gx, gy = np.empty_like(height), np.empty_like(height)
    for h, out in ((height, gx), (height.swapaxes(-1, -2), gy.swapaxes(-1, -2))):
        last = h.shape[-1] - 1
        np.subtract(h[..., 2:], h[..., :-2], out=out[..., 1:-1])
        out[..., 1:-1] *= np.float32(0.5) * per_px
        out[..., 0] = (h[..., min(1, last)] - h[..., 0]) * per_px
        out[..., last] = (h[..., last] - h[..., max(last - 1, 0)]) * per_px
    return gx, gy
