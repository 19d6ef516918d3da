"""Compiled slopes of height images, a row at a time."""
# pyright: basic

import numpy as np

from pipeline.base.cached_kernels import inline_kernel, kernel


@kernel()
def write_slopes(height, per_px, gx, gy):
    """Write the slopes of height images (n, rows, cols) to gx, gy: central differences, one-sided at the border."""
    rows, cols = height.shape[1:]
    half, one, last = np.float32(0.5) * per_px, np.uint64(1), np.uint64(cols - 1)
    for m in range(height.shape[0]):
        image = np.uint64(m)
        for row in range(rows):
            r, up, down = np.uint64(row), np.uint64(max(row - 1, 0)), np.uint64(min(row + 1, rows - 1))
            scale = half if 0 < row < rows - 1 else per_px
            for i in range(cols):
                c = np.uint64(i)
                gy[image, r, c] = (height[image, down, c] - height[image, up, c]) * scale
            for i in range(1, cols - 1):
                c = np.uint64(i)
                gx[image, r, c] = (height[image, r, c + one] - height[image, r, c - one]) * half
            gx[image, r, 0] = (height[image, r, min(1, cols - 1)] - height[image, r, 0]) * per_px
            gx[image, r, last] = (height[image, r, last] - height[image, r, max(cols - 2, 0)]) * per_px


@inline_kernel()
def write_row_slopes(height, r, per_px, gx, gy):
    """Write the slopes of row `r` of one image (rows, cols) to gx, gy (cols,)."""
    rows, cols = height.shape
    half = np.float32(0.5) * per_px
    here, up, down = height[r], height[max(r - 1, 0)], height[min(r + 1, rows - 1)]
    _scaled_difference(down, up, half if 0 < r < rows - 1 else per_px, gy)
    _scaled_difference(here[2:], here[:-2], half, gx[1:-1])
    last = cols - 1
    gx[0] = (here[min(1, last)] - here[0]) * per_px
    gx[last] = (here[last] - here[max(last - 1, 0)]) * per_px


@inline_kernel()
def _scaled_difference(plus, minus, scale, out):
    for i in range(out.shape[0]):
        c = np.uint64(i)
        out[c] = (plus[c] - minus[c]) * scale
