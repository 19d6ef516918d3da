# pyright: basic
"""Compiled loops of the bubble: projected multigrid for its membrane.

The unknown v is the membrane's deviation from its rest shape, 0 where `free` is False (rim and beyond):
-lap v = load where v < room, -lap v <= load where v = room, and never v > room.
"""

import math

from pipeline.base.kept_kernels import FAST, kernel


@kernel(fastmath=FAST)
def smooth(v, load, room, free, step_sq, sweeps):
    """Projected Gauss-Seidel in red-black order."""
    rows, cols = v.shape
    for _ in range(sweeps):
        for colour in range(2):
            for r in range(1, rows - 1):
                for c in range(1 + (r + colour) % 2, cols - 1, 2):
                    if free[r, c]:
                        new = 0.25 * (v[r - 1, c] + v[r + 1, c] + v[r, c - 1] + v[r, c + 1] + step_sq * load[r, c])
                        v[r, c] = min(new, room[r, c])


@kernel(fastmath=FAST)
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


@kernel(fastmath=FAST)
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


@kernel(fastmath=FAST)
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


@kernel(fastmath=FAST)
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


@kernel(fastmath=FAST)
def not_held(v, left, room, free, loose):
    """Nodes that may move and are not held by the object."""
    rows, cols = v.shape
    for r in range(rows):
        for c in range(cols):
            loose[r, c] = free[r, c] and not (v[r, c] >= room[r, c] and left[r, c] == 0.0)


@kernel(fastmath=FAST)
def smooth_open(v, load, free, step_sq, sweeps):
    """Gauss-Seidel in red-black order where there is no object."""
    rows, cols = v.shape
    for _ in range(sweeps):
        for colour in range(2):
            for r in range(1, rows - 1):
                for c in range(1 + (r + colour) % 2, cols - 1, 2):
                    if free[r, c]:
                        v[r, c] = 0.25 * (v[r - 1, c] + v[r + 1, c] + v[r, c - 1] + v[r, c + 1] + step_sq * load[r, c])


@kernel(fastmath=FAST)
def residual_open(v, load, free, step_sq, out):
    """load + lap v on the free nodes, 0 elsewhere."""
    rows, cols = v.shape
    inverse = 1.0 / step_sq
    out[:] = 0.0
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            if free[r, c]:
                lap = (v[r - 1, c] + v[r + 1, c] + v[r, c - 1] + v[r, c + 1] - 4.0 * v[r, c]) * inverse
                out[r, c] = load[r, c] + lap


@kernel(fastmath=FAST)
def restrict_open(fine, coarse):
    """Full weighting of a residual."""
    rows, cols = coarse.shape
    coarse[:] = 0.0
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            y = 2 * r
            x = 2 * c
            coarse[r, c] = (
                0.25 * fine[y, x]
                + 0.125 * (fine[y - 1, x] + fine[y + 1, x] + fine[y, x - 1] + fine[y, x + 1])
                + 0.0625 * (fine[y - 1, x - 1] + fine[y - 1, x + 1] + fine[y + 1, x - 1] + fine[y + 1, x + 1])
            )


@kernel(fastmath=FAST)
def prolong_open(coarse, v, free):
    """Add a coarse correction, bilinear between its nodes."""
    rows, cols = v.shape
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            if free[r, c]:
                j = r // 2
                i = c // 2
                j2 = j + r % 2
                i2 = i + c % 2
                v[r, c] += 0.25 * (coarse[j, i] + coarse[j, i2] + coarse[j2, i] + coarse[j2, i2])


@kernel(fastmath=FAST)
def stiffness(p, free, step_sq, out):
    """Out = -lap p on the free nodes; their product with p."""
    rows, cols = p.shape
    inverse = 1.0 / step_sq
    total = 0.0
    out[:] = 0.0
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            if free[r, c]:
                q = (4.0 * p[r, c] - p[r - 1, c] - p[r + 1, c] - p[r, c - 1] - p[r, c + 1]) * inverse
                out[r, c] = q
                total += q * p[r, c]
    return total


@kernel(fastmath=FAST)
def dot(a, b):
    total = 0.0
    for r in range(a.shape[0]):
        for c in range(a.shape[1]):
            total += a[r, c] * b[r, c]
    return total


@kernel(fastmath=FAST)
def add_scaled(a, factor, b):
    """Replace b by a + factor b."""
    for r in range(a.shape[0]):
        for c in range(a.shape[1]):
            b[r, c] = a[r, c] + factor * b[r, c]


@kernel(fastmath=FAST)
def walk(v, left, direction, moved, length):
    """A step of conjugate gradients, in place; how far the farthest node went."""
    farthest = 0.0
    for r in range(v.shape[0]):
        for c in range(v.shape[1]):
            step = length * direction[r, c]
            v[r, c] += step
            left[r, c] -= length * moved[r, c]
            farthest = max(farthest, abs(step))
    return farthest


@kernel(fastmath=FAST)
def largest_change(a, b):
    """Greatest |a - b|; NaN counts as infinite."""
    largest = 0.0
    for r in range(a.shape[0]):
        for c in range(a.shape[1]):
            change = abs(a[r, c] - b[r, c])
            if not change <= largest:
                largest = change if change > largest else math.inf
    return largest


@kernel()
def halve_free(free, careful, coarse):
    """Coarse nodes that are free; if `careful` only with their four neighbours, so that none held is lifted."""
    rows, cols = coarse.shape
    coarse[:] = False
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            y = 2 * r
            x = 2 * c
            coarse[r, c] = free[y, x]
            if careful:
                coarse[r, c] &= free[y - 1, x] and free[y + 1, x] and free[y, x - 1] and free[y, x + 1]
