"""Compiled loops of the node *change*: pressures of a dent, and block means of a moved image."""
# pyright: basic

import math

import numpy as np

from pipeline.core.cached_kernels import FAST, kernel


@kernel(fastmath=FAST)
def descend_pressures(curvature, pull, iterations, settled, pressures):
    """Move `pressures` (m,) to the least of p.G.p / 2 - c.p over p >= 0; return the iterations.

    Accelerated projected gradients with restarts (FISTA; Beck and Teboulle 2009; O'Donoghue and
    Candes 2015). `curvature` G (m, m) is positive definite, with a largest eigenvalue of at most 1;
    `pull` is c. Ends with a step that moves no pressure by more than the share `settled` of the
    largest. Rows of pressures that are zero are skipped: most are.
    """
    n = len(pull)
    ahead = np.empty(n, np.float32)
    stepped = np.empty(n, np.float32)
    zero = np.float32(0.0)
    momentum = 1.0
    for i in range(n):
        ahead[i] = pressures[i]
    for iteration in range(iterations):
        for i in range(n):
            stepped[i] = ahead[i] + pull[i]
        for j in range(n):
            weight = ahead[j]
            if weight != zero:
                row = curvature[j]
                for i in range(n):
                    stepped[i] -= weight * row[i]
        turned = zero
        largest = zero
        moved_most = zero
        for i in range(n):
            value = max(stepped[i], zero)
            moved = value - pressures[i]
            turned += (ahead[i] - value) * moved
            largest = max(largest, value)
            moved_most = max(moved_most, abs(moved))
            stepped[i] = value
        following = (1.0 + math.sqrt(1.0 + 4.0 * momentum * momentum)) / 2.0
        share = zero if turned > zero else np.float32((momentum - 1.0) / following)
        momentum = 1.0 if turned > zero else following
        for i in range(n):
            ahead[i] = stepped[i] + share * (stepped[i] - pressures[i])
            pressures[i] = stepped[i]
        if moved_most <= settled * largest:
            return iteration + 1
    return iterations


@kernel()
def measure_moved_blocks(sums, first, block, scale, mean, by_x, by_y):
    """Write means of the blocks (rows, cols, 3) of an image, and their derivatives by its shift.

    `sums` (.., .., 3): its sums over all rectangles; `first`: the row and column, with fractions,
    at which the first block begins; `scale` makes a sum a mean.
    """
    rows, cols, _ = mean.shape
    corners = np.empty((2, cols + 1, 5, 3))
    for r in range(rows + 1):
        here = corners[r % 2]
        for c in range(cols + 1):
            y = first[0] + block * r
            x = first[1] + block * c
            top = int(y)
            left = int(x)
            down = y - top
            right = x - left
            for k in range(3):
                # sums at the corner and at its four neighbours, a pixel away
                for way in range(5):
                    i = top + (way == 3) - (way == 4)
                    j = left + (way == 1) - (way == 2)
                    upper = sums[i, j, k] * (1.0 - right) + sums[i, j + 1, k] * right
                    lower = sums[i + 1, j, k] * (1.0 - right) + sums[i + 1, j + 1, k] * right
                    here[c, way, k] = upper * (1.0 - down) + lower * down
        if r == 0:
            continue
        above = corners[(r - 1) % 2]
        for c in range(cols):
            for k in range(3):
                means = here[c + 1, :, k] - here[c, :, k] - above[c + 1, :, k] + above[c, :, k]
                mean[r - 1, c, k] = scale * means[0]
                by_x[r - 1, c, k] = scale * 0.5 * (means[1] - means[2])
                by_y[r - 1, c, k] = scale * 0.5 * (means[3] - means[4])
