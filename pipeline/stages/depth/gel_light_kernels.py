"""Compiled Gauss-Newton step from the slopes of a surface to those that explain a picture (`gel_light`)."""
# pyright: basic

import math

import numpy as np

from pipeline.base.kept_kernels import FAST, kernel

_DARK, _BRIGHT = np.float32(0.5), np.float32(254.0)  # a camera tells nothing beyond
_NOISE = np.float32(1.5)  # grey levels
_LONGEST = np.float32(0.3)  # mm/mm of one step: the light is linear in the slope for about that far


@kernel(fastmath=FAST, error_model="numpy")
def explained(rest, change, still, share, by_x, by_y, moved, pull, huber, steepest, gx, gy):
    """Add to the slopes gx, gy of every pixel of `moved` the step that best explains `rest`; zero them elsewhere.

    rest, change, still, share, by_x, by_y (rows, cols, 3): what the rendered change lacks, the change seen and the
    untouched picture in grey levels, the share of light that gets there, and the light's rates with the slopes.
    """
    rows, cols = moved.shape
    for r in range(rows):
        for c in range(cols):
            if not moved[r, c]:
                gx[r, c] = gy[r, c] = np.float32(0.0)
                continue
            xx, xy, yy = pull, np.float32(0.0), pull
            x, y = np.float32(0.0), np.float32(0.0)
            for k in range(3):
                off = rest[r, c, k]
                seen = still[r, c, k] + change[r, c, k]
                drawn = seen - off
                if (drawn < _DARK and seen < _DARK + _NOISE) or (drawn > _BRIGHT and seen > _BRIGHT - _NOISE):
                    continue
                weight = min(np.float32(1.0), huber / max(abs(off), np.float32(1e-6)))
                jx, jy = by_x[r, c, k] * share[r, c, k], by_y[r, c, k] * share[r, c, k]
                xx += weight * jx * jx
                xy += weight * jx * jy
                yy += weight * jy * jy
                x += weight * jx * off
                y += weight * jy * off
            per = np.float32(1.0) / (xx * yy - xy * xy)
            step_x, step_y = (yy * x - xy * y) * per, (xx * y - xy * x) * per
            length = math.sqrt(step_x * step_x + step_y * step_y)
            cut = _LONGEST / length if length > _LONGEST else np.float32(1.0)
            gx[r, c] += step_x * cut
            gy[r, c] += step_y * cut
            length = math.sqrt(gx[r, c] * gx[r, c] + gy[r, c] * gy[r, c])
            if length > steepest:
                gx[r, c] *= steepest / length
                gy[r, c] *= steepest / length
