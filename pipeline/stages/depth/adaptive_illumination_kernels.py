"""Compiled light of a surface in a field, and the Gauss-Newton step to slopes that explain a picture (`own_light`)."""
# pyright: basic

import numpy as np

from pipeline.base.cached_kernels import FAST, kernel
from pipeline.stages.depth.slope_step_kernels import accumulate_normal_equations, solve_slope_step


@kernel(fastmath=FAST)
def render_pixels(gx, gy, z, field, out):
    """Write to `out` (rows, cols, 3) the grey levels that slopes gx, gy and an indentation z (mm) change.

    field (rows, cols, 3, 4): by how many the normal's parts along x, y and z, and a mm, change each colour.
    """
    rows, cols = gx.shape
    one = np.float32(1.0)
    for r in range(rows):
        for c in range(cols):
            sx, sy = gx[r, c], gy[r, c]
            n = one / np.sqrt(one + sx * sx + sy * sy)
            for k in range(3):
                a = field[r, c, k]
                out[r, c, k] = -(a[0] * sx + a[1] * sy) * n + a[2] * (n - one) + a[3] * z[r, c]


@kernel(fastmath=FAST)
def update_slopes(rest, change, still, moved, field, pull, huber, steepest, gx, gy):
    """Add to the slopes gx, gy of every pixel of `moved` the step that best explains `rest`; zero them elsewhere.

    rest, change, still (rows, cols, 3): what the rendered change lacks, the change seen and the untouched picture in
    grey levels. pull holds every step back; a misfit beyond `huber` pulls no harder. Returns the
    sum of what was left before the step, each no larger than twice that.
    """
    rows, cols = moved.shape
    one, nothing, misfit = np.float32(1.0), np.float32(0.0), 0.0
    for r in range(rows):
        for c in range(cols):
            if not moved[r, c]:
                gx[r, c] = gy[r, c] = nothing
                continue
            sx, sy = gx[r, c], gy[r, c]
            n = one / np.sqrt(one + sx * sx + sy * sy)
            bent = n * n * n
            sums = (pull, nothing, pull, nothing, nothing, nothing)
            for k in range(3):
                a = field[r, c, k]
                along = (a[0] * sx + a[1] * sy - a[2]) * bent
                to_x, to_y = along * sx - a[0] * n, along * sy - a[1] * n
                sums = accumulate_normal_equations(
                    sums, to_x, to_y, rest[r, c, k], still[r, c, k] + change[r, c, k], huber
                )
            misfit += sums[5]
            gx[r, c], gy[r, c] = solve_slope_step(sx, sy, sums, steepest)
    return misfit
