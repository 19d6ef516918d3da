"""Compiled parts of the integration of slopes, equally or individually weighted (`poisson`).

Images are (n, rows, cols): n at once.
"""
# pyright: basic

import numpy as np

from pipeline.base.cached_kernels import FAST, kernel


@kernel(fastmath=FAST)
def compute_divergence(gx, gy, free, out):
    """Write the negated divergence of slopes into `out`; free (4,): whether the left, right, top, bottom side is free.

    A held side lies half a pixel outside: the edge to it has its pixel's slope. A free side has no edge. This is the
    negated transpose of D applied to the slopes. Returns 0, or NaN if a slope is not finite.
    """
    rows, cols = gx.shape[1:]
    nothing, half = np.float32(0.0), np.float32(0.5)
    total, one, last = nothing, np.uint64(1), np.uint64(cols - 1)
    for m in range(gx.shape[0]):
        image = np.uint64(m)
        for row in range(rows):
            r, above, below = np.uint64(row), np.uint64(max(row - 1, 0)), np.uint64(min(row + 1, rows - 1))
            up = half if row == 0 and free[2] else -half
            down = -half if row == rows - 1 and free[3] else half
            for i in range(cols):
                c = np.uint64(i)
                out[image, r, c] = up * gy[image, above, c] + down * gy[image, below, c]
            for i in range(1, cols - 1):
                c = np.uint64(i)
                out[image, r, c] += half * (gx[image, r, c + one] - gx[image, r, c - one])
            out[image, r, 0] += (half if free[0] else -half) * gx[image, r, 0]
            out[image, r, last] += (-half if free[1] else half) * gx[image, r, last]
            if cols > 1:
                out[image, r, 0] += half * gx[image, r, one]
                out[image, r, last] -= half * gx[image, r, last - one]
            for i in range(cols):
                total += nothing * out[image, r, np.uint64(i)]
    return total


@kernel()
def compute_pivots(waves, first, last, per, out, slow):
    """Write the inverse pivots (rows, modes) of a five-point operator, tridiagonal along the rows, diagonal in modes.

    waves (modes,): its eigenvalues along the other axis. first, last: the diagonal at the ends at both sides, 1 at a
    free one, 3 at one that is held. per (modes,): zeros, scratch. slow (rows, at most modes): the same of
    the first modes. A zero pivot (the constant mode) counts as infinite.
    """
    rows, modes = out.shape
    for r in range(rows):
        own = first if r == 0 else (last if r == rows - 1 else 2.0)
        if rows == 1:
            own = first + last - 2.0
        for i in range(modes):
            k = np.uint64(i)
            pivot = own + waves[k] - per[k]
            per[k] = 1.0 / pivot if pivot > 1e-12 else 0.0
            out[r, k] = per[k]
        for k in range(slow.shape[1]):
            slow[r, k] = per[k]


@kernel(fastmath=FAST)
def solve_tridiagonal(wave, per, scale, slow, line):
    """Solve in place for `wave` (n, rows, modes), times `scale`, with `per` and `slow` of `pivots`.

    The modes of `slow`, the longest waves, are solved in double precision; line, of the same shape: scratch. If only
    differences of the first mode are determined, its mean is zero.
    """
    (rows, few), modes, one = slow.shape, wave.shape[2], np.uint64(1)
    for m in range(wave.shape[0]):
        image = np.uint64(m)
        for row in range(rows):
            r = np.uint64(row)
            for i in range(few):
                k = np.uint64(i)
                line[r, k] = scale * wave[image, r, k] + (line[r - one, k] * slow[r - one, k] if row > 0 else 0.0)
            for i in range(modes):
                k = np.uint64(i)
                wave[image, r, k] *= scale
                if row > 0:
                    wave[image, r, k] += per[r - one, k] * wave[image, r - one, k]
        mean = 0.0
        for row in range(rows - 1, -1, -1):
            r, after = np.uint64(row), np.uint64(min(row + 1, rows - 1))
            on = np.float32(1.0 if row < rows - 1 else 0.0)
            for i in range(modes):
                k = np.uint64(i)
                wave[image, r, k] = per[r, k] * (wave[image, r, k] + on * wave[image, after, k])
            for i in range(few):
                k = np.uint64(i)
                line[r, k] = slow[r, k] * (line[r, k] + on * line[after, k])
            mean += line[r, 0] / rows
        if slow[rows - 1, 0] != 0:
            mean = 0.0
        for r in range(rows):
            line[r, 0] -= mean
            for k in range(few):
                wave[image, r, k] = line[r, k]


# Conjugate gradients on sum (grad z - g)' A (grad z - g): z a surface, A a matrix (xx, xy, yy) a pixel. Fields are
# (n, pixels), weights (pixels,).


@kernel(fastmath=FAST)
def compute_residual(slope_x, slope_y, wanted_x, wanted_y, xx, xy, yy, left_x, left_y):
    """Write the residual A (wanted - slopes)."""
    for m in range(slope_x.shape[0]):
        image = np.uint64(m)
        for i in range(slope_x.shape[1]):
            p = np.uint64(i)
            x, y = wanted_x[image, p] - slope_x[image, p], wanted_y[image, p] - slope_y[image, p]
            left_x[image, p] = xx[p] * x + xy[p] * y
            left_y[image, p] = xy[p] * x + yy[p] * y


@kernel(fastmath=FAST)
def compute_energy(slope_x, slope_y, left_x, left_y, energy):
    """Write the sums (n,) of the residual times the slopes of a step."""
    for m in range(slope_x.shape[0]):
        image, total = np.uint64(m), 0.0
        for i in range(slope_x.shape[1]):
            p = np.uint64(i)
            total += left_x[image, p] * slope_x[image, p] + left_y[image, p] * slope_y[image, p]
        energy[image] = total


@kernel(fastmath=FAST)
def update_direction(step, slope_x, slope_y, on, xx, xy, yy, way, along_x, along_y, stiff):
    """Set the direction, and its slopes, to `step` plus `on` (n,) times the old; write slopes' A slopes (n,)."""
    for m in range(step.shape[0]):
        image, total = np.uint64(m), 0.0
        share = np.float32(on[image])
        for i in range(step.shape[1]):
            p = np.uint64(i)
            way[image, p] = share * way[image, p] + step[image, p]
            x = share * along_x[image, p] + slope_x[image, p]
            y = share * along_y[image, p] + slope_y[image, p]
            along_x[image, p], along_y[image, p] = x, y
            total += x * (xx[p] * x + xy[p] * y) + y * (xy[p] * x + yy[p] * y)
        stiff[image] = total


@kernel(fastmath=FAST)
def advance_solution(far, way, along_x, along_y, xx, xy, yy, surface, left_x, left_y):
    """Advance surfaces and residuals by `far` (n,) along the direction."""
    for m in range(way.shape[0]):
        image = np.uint64(m)
        share = np.float32(far[image])
        for i in range(way.shape[1]):
            p = np.uint64(i)
            x, y = along_x[image, p], along_y[image, p]
            surface[image, p] += share * way[image, p]
            left_x[image, p] -= share * (xx[p] * x + xy[p] * y)
            left_y[image, p] -= share * (xy[p] * x + yy[p] * y)
