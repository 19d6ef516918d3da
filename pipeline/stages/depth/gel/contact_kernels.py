"""Compiled parts of the contact by load (`contact`). Arrays are (rows, cols)."""
# pyright: basic

import numpy as np

from pipeline.base.cached_kernels import FAST, kernel


@kernel(fastmath=FAST)
def compute_divergence(surface, inside, per_cell, out):
    """Write the negated divergence of the slopes between neighbours that are both `inside`; other slopes are zero."""
    rows, cols = surface.shape
    out[:] = np.float32(0.0)
    for r in range(rows):
        for c in range(cols):
            if not inside[r, c]:
                continue
            if c + 1 < cols and inside[r, c + 1]:
                step = per_cell * (surface[r, c + 1] - surface[r, c])
                out[r, c] -= step
                out[r, c + 1] += step
            if r + 1 < rows and inside[r + 1, c]:
                step = per_cell * (surface[r + 1, c] - surface[r, c])
                out[r, c] -= step
                out[r + 1, c] += step


@kernel(fastmath=FAST)
def descend(pressure, ahead, gradient, allowed, step, penalty, momentum):
    """One accelerated projected step, in place: `ahead` is the extrapolated point that `gradient` was computed at.

    Pressure is zero where not `allowed`. Returns the next momentum's parameter; momentum restarts where it points
    uphill (O'Donoghue and Candes 2015).
    """
    rows, cols = pressure.shape
    nothing, uphill = np.float32(0.0), 0.0
    for r in range(rows):
        for c in range(cols):
            new = max(ahead[r, c] - step * (gradient[r, c] + penalty), nothing) if allowed[r, c] else nothing
            uphill += (ahead[r, c] - new) * (new - pressure[r, c])
            gradient[r, c] = new  # its memory holds the new pressure from here on
    if uphill > 0.0:
        momentum = 1.0
    following = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * momentum * momentum))
    along = np.float32((momentum - 1.0) / following)
    for r in range(rows):
        for c in range(cols):
            new = gradient[r, c]
            ahead[r, c] = new + along * (new - pressure[r, c])
            pressure[r, c] = new
    return following
