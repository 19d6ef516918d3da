# pyright: basic
"""Compiled loops of the registration: robust Gauss-Newton on signed distances, frozen where the data say nothing.

Everything runs on one thread and adds up in the order of the points: the same bytes on any machine with the same one.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pipeline.geometry.distance_grid_kernels import look_up
from pipeline.registration.step_kernels import move, orthonormal, step

CONVERGED, OUT_OF_ITERATIONS, NOTHING_NEAR = 0, 1, 2
N_SUMS = 31  # 21 of H, 6 of g, weight, squares within reach, points within reach, robust cost
_BINS = 1024
_SPREAD = 1.4826  # standard deviation of a normal distribution over its median magnitude
_BENDS_AT = 5.0  # spreads at which a residual counts a quarter: 1.5 % less efficient than least squares
_SHRINK = 0.3  # smallest factor from one iteration's scale to the next


@njit(cache=True)
def gather(points, turn, shift, grid, radius, scale, reach, bins, sums):
    """Normal equations in the object's axes about the points' middle, rotations times `radius`: into `sums`."""
    origin, step, shape, coarse, block, fine, quantum = grid
    r00, r01, r02 = turn[0, 0], turn[0, 1], turn[0, 2]
    r10, r11, r12 = turn[1, 0], turn[1, 1], turn[1, 2]
    r20, r21, r22 = turn[2, 0], turn[2, 1], turn[2, 2]
    t0, t1, t2 = shift[0], shift[1], shift[2]
    mx, my, mz = -(r00 * t0 + r10 * t1 + r20 * t2), -(r01 * t0 + r11 * t1 + r21 * t2), -(r02 * t0 + r12 * t1 + r22 * t2)
    sums[:] = 0.0
    bins[:] = 0
    square, per_mm, to_bin = scale * scale, 1.0 / radius, 1.0 / reach
    for n in range(points.shape[0]):
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        ax, ay, az = r00 * px + r10 * py + r20 * pz, r01 * px + r11 * py + r21 * pz, r02 * px + r12 * py + r22 * pz
        d, gx, gy, gz = look_up(ax + mx, ay + my, az + mz, origin, step, shape, coarse, block, fine, quantum)
        far = abs(d)
        robust = square / (square + d * d)
        weight = robust * robust  # Geman and McClure's
        sums[30] += d * d * robust
        if far <= reach:
            sums[28] += d * d
            sums[29] += 1.0
            bins[min(int(math.sqrt(far * to_bin) * _BINS), _BINS - 1)] += 1
        j0, j1, j2 = (ay * gz - az * gy) * per_mm, (az * gx - ax * gz) * per_mm, (ax * gy - ay * gx) * per_mm
        w0, w1, w2, w3, w4, w5 = weight * j0, weight * j1, weight * j2, weight * gx, weight * gy, weight * gz
        sums[0] += w0 * j0
        sums[1] += w0 * j1
        sums[2] += w0 * j2
        sums[3] += w0 * gx
        sums[4] += w0 * gy
        sums[5] += w0 * gz
        sums[6] += w1 * j1
        sums[7] += w1 * j2
        sums[8] += w1 * gx
        sums[9] += w1 * gy
        sums[10] += w1 * gz
        sums[11] += w2 * j2
        sums[12] += w2 * gx
        sums[13] += w2 * gy
        sums[14] += w2 * gz
        sums[15] += w3 * gx
        sums[16] += w3 * gy
        sums[17] += w3 * gz
        sums[18] += w4 * gy
        sums[19] += w4 * gz
        sums[20] += w5 * gz
        sums[21] += w0 * d
        sums[22] += w1 * d
        sums[23] += w2 * d
        sums[24] += w3 * d
        sums[25] += w4 * d
        sums[26] += w5 * d
        sums[27] += weight


@njit(cache=True)
def spread(bins, reach):
    """Robust standard deviation of the residuals that were counted within `reach`."""
    half, passed = bins.sum() / 2.0, 0
    for k in range(_BINS):
        if passed + bins[k] >= half:
            low, high = reach * (k / _BINS) ** 2, reach * ((k + 1) / _BINS) ** 2
            return _SPREAD * (low + (high - low) * (half - passed) / max(bins[k], 1))
        passed += bins[k]
    return reach


@njit(cache=True)
def fit(points, turn, shift, grid, radius, reach, scale, floor, rule, settled, most):
    """Register points (n, 3) about their middle; `turn` and `shift` move in place.

    Returns (each pose (k, 14) with rmse and share, status, spread, hessian in the object's axes, weak directions
    (6, k), scale).
    """
    history = np.empty((most + 1, 14))
    sums, bins = np.zeros(N_SUMS), np.zeros(_BINS, np.int64)
    status, n, noise = OUT_OF_ITERATIONS, 0, floor
    h, weak = np.zeros((6, 6)), np.eye(6)
    last = 1e300
    for n in range(most + 1):
        gather(points, turn, shift, grid, radius, scale, reach, bins, sums)
        noise = max(spread(bins, reach), floor) if sums[29] > 0 else reach
        for k in range(9):
            history[n, k] = turn[k // 3, k % 3]
        for k in range(3):
            history[n, 9 + k] = shift[k]
        history[n, 12] = math.sqrt(sums[28] / sums[29]) if sums[29] > 0 else 0.0
        history[n, 13] = sums[29] / points.shape[0]
        # A start may lie off by more than the search distance: as long as the weights tell a way, it is gone.
        if not sums[27] > 0:
            return history[: n + 1], NOTHING_NEAR, noise, h, weak, scale
        motion, h, weak = step(sums, noise if last <= settled else floor, rule[0], radius, rule[1], rule[2], rule[3])
        bend = min(scale, max(_BENDS_AT * noise, _SHRINK * scale))
        if last <= settled and bend > 0.9 * scale:
            status = CONVERGED
            break
        if n == most:
            break
        # While the pose is still off, misfit is no noise: only what is known of the sensor freezes directions.
        scale = bend
        last = move(turn, shift, motion, radius, reach)
        orthonormal(turn)
    if sums[29] == 0:
        status = NOTHING_NEAR
    return history[: n + 1], status, noise, h, weak, scale


@njit(cache=True)
def fit_each(points, turns, shifts, grid, radius, reach, scale, floor, rule, settled, most, judged):
    """Register the same few points from each start (in place); (n,) mean robust squares at the scale `judged`."""
    cost = np.empty(turns.shape[0])
    sums, bins = np.zeros(N_SUMS), np.zeros(_BINS, np.int64)
    for k in range(turns.shape[0]):
        fit(points, turns[k], shifts[k], grid, radius, reach, scale, floor, rule, settled, most)
        gather(points, turns[k], shifts[k], grid, radius, judged, reach, bins, sums)
        cost[k] = sums[30] / points.shape[0]
    return cost
