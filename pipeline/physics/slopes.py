"""Slopes of height images."""

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats


def compute_slopes(height_mm: NDArray[np.floating], pixel_mm: float) -> tuple[Floats, Floats]:
    """(d/dx, d/dy) in mm/mm of height images (..., rows, cols): central differences, one-sided
    at the border.
    """
    from pipeline.physics.slope_kernels import write_slopes

    # a copy: the kernel is compiled again for read-only arrays
    height = np.array(height_mm, np.float32, order="C")
    gx = np.empty_like(height)
    gy = np.empty_like(height)
    images, out_x, out_y = (a.reshape(-1, *height.shape[-2:]) for a in (height, gx, gy))
    write_slopes(images, np.float32(1.0) / np.float32(pixel_mm), out_x, out_y)
    return gx, gy
