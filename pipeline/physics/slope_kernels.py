"""Compiled slopes of height images, a row at a time."""
# pyright: basic

import numpy as np

from pipeline.core.cached_kernels import inline_kernel, kernel


@kernel()
def write_slopes(height, per_px, gx, gy):
    """Write the slopes of height images (n, rows, cols) to gx, gy: central differences,
    one-sided at the border.
    """
    for m in range(height.shape[0]):
        for r in range(height.shape[1]):
            write_row_slopes(height[m], r, per_px, gx[m, r], gy[m, r])


@inline_kernel()
def write_row_slopes(height, r, per_px, gx, gy):
    """Write the slopes of row `r` of one image (rows, cols) to gx, gy (cols,)."""
    rows, cols = height.shape
    half = np.float32(0.5) * per_px
    here = height[r]
    up = height[max(r - 1, 0)]
    down = height[min(r + 1, rows - 1)]
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
