"""Compiled parts of the integration of slopes, equally or individually weighted (`poisson`).

Images are (n, rows, cols): n at once.
"""
# pyright: basic

import numpy as np

from pipeline.core.cached_kernels import FAST, kernel
from pipeline.physics.slope_kernels import write_slopes

_ENERGY_MIN = 1e-20


@kernel(fastmath=FAST)
def compute_divergence(gx, gy, free, out):
    """Write the negated divergence of slopes gx, gy (n, rows, cols) into `out`.

    Free (4,): whether a side is free.

    A held side lies half a pixel outside: the edge to it has its pixel's slope. A free side has no
    edge. This is the negated transpose of D applied to the slopes. Returns 0, or NaN if a slope is
    not finite.
    """
    rows, cols = gx.shape[1:]
    nothing = np.float32(0.0)
    half = np.float32(0.5)
    total = nothing
    one = np.uint64(1)
    last = np.uint64(cols - 1)
    for m in range(gx.shape[0]):
        image = np.uint64(m)
        for row in range(rows):
            r = np.uint64(row)
            above = np.uint64(max(row - 1, 0))
            below = np.uint64(min(row + 1, rows - 1))
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
    """Write the inverse pivots (rows, modes) of a five-point operator, tridiagonal along the rows,
    diagonal in modes.

    waves (modes,): its eigenvalues along the other axis. first, last: the diagonal at the ends at
    both sides, 1 at a free one, 3 at one that is held. per (modes,): zeros, scratch. slow (rows, at
    most modes): the same of the first modes. A zero pivot (the constant mode) counts as infinite.
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

    The modes of `slow`, the longest waves, are solved in double precision; line, of the same shape:
    scratch. If only differences of the first mode are determined, its mean is zero.
    """
    (rows, few), modes, one = slow.shape, wave.shape[2], np.uint64(1)
    for m in range(wave.shape[0]):
        image = np.uint64(m)
        for row in range(rows):
            r = np.uint64(row)
            for i in range(few):
                k = np.uint64(i)
                line[r, k] = scale * wave[image, r, k] + (
                    line[r - one, k] * slow[r - one, k] if row > 0 else 0.0
                )
            for i in range(modes):
                k = np.uint64(i)
                wave[image, r, k] *= scale
                if row > 0:
                    wave[image, r, k] += per[r - one, k] * wave[image, r - one, k]
        mean = 0.0
        for row in range(rows - 1, -1, -1):
            r = np.uint64(row)
            after = np.uint64(min(row + 1, rows - 1))
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


# Conjugate gradients on sum (grad z - g)' A (grad z - g): z surfaces (n, rows, cols), A a matrix
# (xx, xy, yy) a pixel, `weights` (3, rows, cols). `slopes`, `left` and `along` are (2, n, rows,
# cols): of x and of y.


@kernel(fastmath=FAST)
def compute_residual(surface, wanted_x, wanted_y, weights, per_px, slopes, left):
    """Write the slopes of the surfaces and the residual A (wanted - slopes)."""
    write_slopes(surface, per_px, slopes[0], slopes[1])
    n, rows, cols = surface.shape
    for m in range(n):
        image = np.uint64(m)
        for row in range(rows):
            r = np.uint64(row)
            for i in range(cols):
                c = np.uint64(i)
                x = wanted_x[image, r, c] - slopes[0, image, r, c]
                y = wanted_y[image, r, c] - slopes[1, image, r, c]
                left[0, image, r, c] = weights[0, r, c] * x + weights[1, r, c] * y
                left[1, image, r, c] = weights[1, r, c] * x + weights[2, r, c] * y


@kernel(fastmath=FAST)
def descend(step, weights, per_px, slopes, way, along, energy, surface, left):
    """Take one step of conjugate gradients, `step` being the preconditioned residual.

    Return whether anything moved.

    `way` is the direction and `along` its slopes; energy (n,): the residual times the slopes of the
    last step.
    """
    write_slopes(step, per_px, slopes[0], slopes[1])
    (n, rows, cols), moved = step.shape, False
    for m in range(n):
        image = np.uint64(m)
        new = 0.0
        stiff = 0.0
        for row in range(rows):
            r = np.uint64(row)
            for i in range(cols):
                c = np.uint64(i)
                new += (
                    left[0, image, r, c] * slopes[0, image, r, c]
                    + left[1, image, r, c] * slopes[1, image, r, c]
                )
        share = np.float32(new / energy[image] if energy[image] > _ENERGY_MIN else 0.0)
        energy[image] = new
        for row in range(rows):
            r = np.uint64(row)
            for i in range(cols):
                c = np.uint64(i)
                way[image, r, c] = share * way[image, r, c] + step[image, r, c]
                x = share * along[0, image, r, c] + slopes[0, image, r, c]
                y = share * along[1, image, r, c] + slopes[1, image, r, c]
                along[0, image, r, c] = x
                along[1, image, r, c] = y
                xy = weights[1, r, c]
                stiff += x * (weights[0, r, c] * x + xy * y) + y * (xy * x + weights[2, r, c] * y)
        if stiff <= _ENERGY_MIN or new == 0.0:
            continue
        share = np.float32(new / stiff)
        moved = True
        for row in range(rows):
            r = np.uint64(row)
            for i in range(cols):
                c = np.uint64(i)
                x = along[0, image, r, c]
                y = along[1, image, r, c]
                surface[image, r, c] += share * way[image, r, c]
                left[0, image, r, c] -= share * (weights[0, r, c] * x + weights[1, r, c] * y)
                left[1, image, r, c] -= share * (weights[1, r, c] * x + weights[2, r, c] * y)
    return moved
