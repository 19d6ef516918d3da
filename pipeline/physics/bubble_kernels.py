# pyright: basic
"""Compiled loops of the projected multigrid solver for a bubble's membrane.

The unknown v is the membrane's deviation from its rest shape, 0 where `free` is False (rim and beyond):
-lap v = load where v < room, -lap v <= load where v = room, and never v > room.
"""

from pipeline.base.cached_kernels import FAST, kernel


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
def compute_residual(v, load, room, free, step_sq, out):
    """Write load + lap v at free nodes, 0 in contact and at the rim."""
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
def restrict(fine, coarse):
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
