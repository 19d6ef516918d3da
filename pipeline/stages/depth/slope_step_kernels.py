"""A pixel's Gauss-Newton step to the slope that explains its colours: part of the kernels that render them."""
# pyright: basic

import math

import numpy as np

from pipeline.base.cached_kernels import inline_kernel

_DARK, _BRIGHT = np.float32(0.5), np.float32(254.0)  # a camera tells nothing beyond
_NOISE = np.float32(1.5)  # grey levels
_LONGEST = np.float32(0.3)  # mm/mm of one step: the light is linear in the slope for about that far


@inline_kernel()
def accumulate_normal_equations(sums, jx, jy, off, seen, huber):
    """The normal equations (xx, xy, yy, to x, to y) and what is left, with a colour that is `off` by grey levels.

    It changes by jx and jy with the two slopes, and pulls no harder beyond `huber`, of which at most twice is left; not
    at all where the camera, which has `seen` it, tells nothing.
    """
    xx, xy, yy, to_x, to_y, left = sums
    one, nothing, drawn, away = np.float32(1.0), np.float32(0.0), seen - off, abs(off)
    told = (drawn >= _DARK or seen >= _DARK + _NOISE) and (drawn <= _BRIGHT or seen <= _BRIGHT - _NOISE)
    weight = min(one, huber / max(away, np.float32(1e-6))) if told else nothing
    left += min(away, huber + huber) if told else nothing
    wx, wy = weight * jx, weight * jy
    return xx + wx * jx, xy + wx * jy, yy + wy * jy, to_x + wx * off, to_y + wy * off, left


@inline_kernel()
def solve_slope_step(sx, sy, sums, steepest):
    """The slopes after the step that solves the equations, no longer than `_LONGEST`, nor steeper than `steepest`."""
    one = np.float32(1.0)
    xx, xy, yy, to_x, to_y, _ = sums
    per = one / (xx * yy - xy * xy)
    step_x, step_y = (yy * to_x - xy * to_y) * per, (xx * to_y - xy * to_x) * per
    cut = min(one, _LONGEST / math.sqrt(step_x * step_x + step_y * step_y))
    to_x, to_y = sx + step_x * cut, sy + step_y * cut
    cut = min(one, steepest / math.sqrt(to_x * to_x + to_y * to_y))
    return to_x * cut, to_y * cut
