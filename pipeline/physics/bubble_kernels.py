# pyright: basic
"""Compiled loops of the bubble: projected multigrid for its membrane.

The unknown v is the membrane's deviation from its rest shape, 0 where `free` is False (rim and beyond):
-lap v = load where v < room, -lap v <= load where v = room, and never v > room.
"""

import math

from numba import njit

_FAST = {"contract", "arcp", "nsz", "reassoc"}


@njit(cache=True, fastmath=_FAST)
def smooth(v, load, room, free, step_sq, sweeps):
    """Projected Gauss-Seidel in red-black order; the largest change of the last sweep."""
    rows, cols = v.shape
    change = 0.0
    for _ in range(sweeps):
        change = 0.0
        for colour in range(2):
            for r in range(1, rows - 1):
                for c in range(1 + (r + colour) % 2, cols - 1, 2):
                    if free[r, c]:
                        new = 0.25 * (v[r - 1, c] + v[r + 1, c] + v[r, c - 1] + v[r, c + 1] + step_sq * load[r, c])
                        new = min(new, room[r, c])
                        change = max(change, abs(new - v[r, c]))
                        v[r, c] = new
    return change


@njit(cache=True, fastmath=_FAST)
def residual(v, load, room, free, step_sq, out):
    """load + lap v where the membrane is free to follow it, 0 where the object holds it or the rim does."""
    rows, cols = v.shape
    inverse = 1.0 / step_sq
    out[:] = 0.0
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            if free[r, c]:
                lap = (v[r - 1, c] + v[r + 1, c] + v[r, c - 1] + v[r, c + 1] - 4.0 * v[r, c]) * inverse
                left = load[r, c] + lap
                if not (left > 0.0 and v[r, c] >= room[r, c]):
                    out[r, c] = left


@njit(cache=True, fastmath=_FAST)
def restrict(fine, v, room, coarse, coarse_room):
    """Full weighting of a residual, and the least room left in the 3 x 3 nodes around each coarse one."""
    rows, cols = coarse.shape
    coarse[:] = 0.0
    coarse_room[:] = math.inf
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            y = 2 * r
            x = 2 * c
            coarse[r, c] = (
                0.25 * fine[y, x]
                + 0.125 * (fine[y - 1, x] + fine[y + 1, x] + fine[y, x - 1] + fine[y, x + 1])
                + 0.0625 * (fine[y - 1, x - 1] + fine[y - 1, x + 1] + fine[y + 1, x - 1] + fine[y + 1, x + 1])
            )
            least = math.inf
            for j in range(y - 1, y + 2):
                for i in range(x - 1, x + 2):
                    least = min(least, room[j, i] - v[j, i])
            coarse_room[r, c] = max(least, 0.0)


@njit(cache=True, fastmath=_FAST)
def prolong(coarse, v, room, free):
    """Add a coarse correction, bilinear between its nodes, without passing the object."""
    rows, cols = v.shape
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            if free[r, c]:
                j = r // 2
                i = c // 2
                j2 = j + r % 2
                i2 = i + c % 2
                add = 0.25 * (coarse[j, i] + coarse[j, i2] + coarse[j2, i] + coarse[j2, i2])
                v[r, c] = min(v[r, c] + add, room[r, c])


@njit(cache=True, fastmath=_FAST)
def held(v, load, room, free, step_sq, force):
    """Force density (in the unit of `load`) with which the object holds the membrane; 0 where it does not."""
    rows, cols = v.shape
    inverse = 1.0 / step_sq
    force[:] = 0.0
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            if free[r, c] and v[r, c] >= room[r, c]:
                lap = (v[r - 1, c] + v[r + 1, c] + v[r, c - 1] + v[r, c + 1] - 4.0 * v[r, c]) * inverse
                force[r, c] = max(load[r, c] + lap, 0.0)
