"""A pixel's Gauss-Newton step to the slope that explains its colours: part of the kernels that render them."""
# pyright: basic

import math

import numpy as np

from pipeline.base.kept_kernels import inlined

_DARK, _BRIGHT = np.float32(0.5), np.float32(254.0)  # a camera tells nothing beyond
_NOISE = np.float32(1.5)  # grey levels
_LONGEST = np.float32(0.3)  # mm/mm of one step: the light is linear in the slope for about that far


@inlined()
def weighed(off, seen, huber):
    """How hard a colour `off` by grey levels pulls, no harder beyond `huber`; 0 where the camera tells nothing."""
    drawn = seen - off
    if (drawn < _DARK and seen < _DARK + _NOISE) or (drawn > _BRIGHT and seen > _BRIGHT - _NOISE):
        return np.float32(0.0)
    return min(np.float32(1.0), huber / max(abs(off), np.float32(1e-6)))


@inlined()
def added(sums, jx, jy, off, weight):
    """The normal equations (xx, xy, yy, to x, to y) with a colour that changes by jx and jy with the two slopes."""
    xx, xy, yy, to_x, to_y = sums
    wx, wy = weight * jx, weight * jy
    return xx + wx * jx, xy + wx * jy, yy + wy * jy, to_x + wx * off, to_y + wy * off


@inlined()
def stepped(sx, sy, sums, steepest):
    """The slopes after the step that solves the equations, no longer than `_LONGEST`, nor steeper than `steepest`."""
    one = np.float32(1.0)
    xx, xy, yy, to_x, to_y = sums
    per = one / (xx * yy - xy * xy)
    step_x, step_y = (yy * to_x - xy * to_y) * per, (xx * to_y - xy * to_x) * per
    length = math.sqrt(step_x * step_x + step_y * step_y)
    cut = _LONGEST / length if length > _LONGEST else one
    to_x, to_y = sx + step_x * cut, sy + step_y * cut
    length = math.sqrt(to_x * to_x + to_y * to_y)
    cut = steepest / length if length > steepest else one
    return to_x * cut, to_y * cut
