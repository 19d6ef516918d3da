"""Compiled light of a surface in a field, and the Gauss-Newton step to slopes that explain a picture (`own_light`)."""
# pyright: basic

import math

import numpy as np

from pipeline.base.kept_kernels import FAST, kernel

_DARK, _BRIGHT = np.float32(0.5), np.float32(254.0)  # a camera tells nothing beyond
_NOISE = np.float32(1.5)  # grey levels
_LONGEST = np.float32(0.3)  # mm/mm of one step: the light is linear in the slope for about that far


@kernel(fastmath=FAST)
def lit(gx, gy, z, field, out):
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
def explained(rest, change, still, moved, field, pull, huber, steepest, gx, gy):
    """Add to the slopes gx, gy of every pixel of `moved` the step that best explains `rest`; zero them elsewhere.

    rest, change, still (rows, cols, 3): what the rendered change lacks, the change seen and the untouched picture in
    grey levels. pull holds every step back; a misfit beyond `huber` pulls no harder. Returns the
    sum of what was left before the step, each no larger than twice that.
    """
    rows, cols = moved.shape
    one, two, nothing, misfit = np.float32(1.0), np.float32(2.0), np.float32(0.0), 0.0
    for r in range(rows):
        for c in range(cols):
            if not moved[r, c]:
                gx[r, c] = gy[r, c] = nothing
                continue
            sx, sy = gx[r, c], gy[r, c]
            n = one / np.sqrt(one + sx * sx + sy * sy)
            bent = n * n * n
            xx, xy, yy, to_x, to_y = pull, nothing, pull, nothing, nothing
            for k in range(3):
                off = rest[r, c, k]
                seen = still[r, c, k] + change[r, c, k]
                drawn = seen - off
                if (drawn < _DARK and seen < _DARK + _NOISE) or (drawn > _BRIGHT and seen > _BRIGHT - _NOISE):
                    continue
                a = field[r, c, k]
                along = (a[0] * sx + a[1] * sy - a[2]) * bent
                jx, jy = along * sx - a[0] * n, along * sy - a[1] * n
                weight = min(one, huber / max(abs(off), np.float32(1e-6)))
                xx += weight * jx * jx
                xy += weight * jx * jy
                yy += weight * jy * jy
                to_x += weight * jx * off
                to_y += weight * jy * off
                misfit += min(abs(off), two * huber)
            per = one / (xx * yy - xy * xy)
            step_x, step_y = (yy * to_x - xy * to_y) * per, (xx * to_y - xy * to_x) * per
            length = math.sqrt(step_x * step_x + step_y * step_y)
            cut = _LONGEST / length if length > _LONGEST else one
            sx += step_x * cut
            sy += step_y * cut
            length = math.sqrt(sx * sx + sy * sy)
            cut = steepest / length if length > steepest else one
            gx[r, c] = sx * cut
            gy[r, c] = sy * cut
    return misfit
