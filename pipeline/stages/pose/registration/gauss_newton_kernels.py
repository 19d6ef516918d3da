# pyright: basic
"""Compiled loops of the registration: robust Gauss-Newton on signed distances.

Undetermined directions are held.

Everything runs on one thread and adds up in the order of the points, so that results are
reproducible.
"""

from __future__ import annotations

import math

from pipeline.core.cached_kernels import inner_kernel, kernel
from pipeline.core.geometry.distance_grid_kernels import look_up
from pipeline.stages.pose.registration.step_kernels import apply_motion, solve_step

N_SUMS = 30  # 21 of H, 6 of g, weight, squares within reach, points within reach
N_BINS = 1024
_SPREAD = 1.4826  # standard deviation of a normal distribution over its median absolute value
_BENDS_AT = (
    # standard deviations at which a residual's weight is a quarter: 1.5 % less efficient than least
    # squares
    5.0
)
_SHRINK = 0.3  # smallest ratio of the scales of two iterations


@inner_kernel()
def accumulate_normal_equations(points, poses, n, grid, radius, scale, reach, bins, sums):
    """Accumulate into `sums` the normal equations in the object's axes about the centroid,
    rotations times `radius`.
    """
    r00 = poses[n, 0]
    r01 = poses[n, 1]
    r02 = poses[n, 2]
    r10 = poses[n, 3]
    r11 = poses[n, 4]
    r12 = poses[n, 5]
    r20 = poses[n, 6]
    r21 = poses[n, 7]
    r22 = poses[n, 8]
    t0 = poses[n, 9]
    t1 = poses[n, 10]
    t2 = poses[n, 11]
    mx = -(r00 * t0 + r10 * t1 + r20 * t2)
    my = -(r01 * t0 + r11 * t1 + r21 * t2)
    mz = -(r02 * t0 + r12 * t1 + r22 * t2)
    for k in range(sums.size):
        sums[k] = 0.0
    for k in range(bins.size):
        bins[k] = 0
    square = scale * scale
    per_mm = 1.0 / radius
    to_bin = 1.0 / reach
    for m in range(points.shape[0]):
        px = points[m, 0]
        py = points[m, 1]
        pz = points[m, 2]
        ax = r00 * px + r10 * py + r20 * pz
        ay = r01 * px + r11 * py + r21 * pz
        az = r02 * px + r12 * py + r22 * pz
        d, gx, gy, gz = look_up(ax + mx, ay + my, az + mz, grid)
        far = abs(d)
        weight = square / (square + d * d)
        weight *= weight  # Geman and McClure's
        if far <= reach:
            sums[28] += d * d
            sums[29] += 1.0
            bins[min(int(math.sqrt(far * to_bin) * N_BINS), N_BINS - 1)] += 1
        row = (
            (ay * gz - az * gy) * per_mm,
            (az * gx - ax * gz) * per_mm,
            (ax * gy - ay * gx) * per_mm,
            gx,
            gy,
            gz,
        )
        at = 0
        for i in range(6):
            weighted = weight * row[i]
            for j in range(i, 6):
                sums[at] += weighted * row[j]
                at += 1
            sums[21 + i] += weighted * d
        sums[27] += weight


@inner_kernel()
def estimate_robust_std(bins, n, reach):
    """Return the robust standard deviation of the n residuals within `reach`.

    `reach` where there are none.
    """
    passed = 0
    for k in range(bins.size):
        if n > 0.0 and passed + bins[k] >= 0.5 * n:
            low = reach * (k / N_BINS) ** 2
            high = reach * ((k + 1) / N_BINS) ** 2
            return _SPREAD * (low + (high - low) * (0.5 * n - passed) / max(bins[k], 1))
        passed += bins[k]
    return reach


@kernel()
def fit_poses(points, poses, grid, size, limits, rule, arrays, history, ended):
    """Register points (n, 3) about their centroid from each pose (k, 12) of rotation and
    translation, in place.

    `size`: the points' radius, search distance, first scale. `limits`: smallest noise, motion that
    ends the iterations. `rule`: for rotations and for translations the variance that does not
    average out and the information required per mm^2 of variance, and what is required of both for
    any noise. `history` (most + 1, 14) holds the iterations of the last pose, with rmse and share;
    `ended` (k, 2) their number and the final scale.
    """
    sums, bins, asked, motion, work = arrays
    radius, reach, _ = size
    floor, settled = limits
    for start in range(poses.shape[0]):
        scale = size[2]
        last = 1e300
        n = 0
        while True:
            accumulate_normal_equations(
                points, poses, start, grid, radius, scale, reach, bins, sums
            )
            for k in range(12):
                history[n, k] = poses[start, k]
            history[n, 12] = math.sqrt(sums[28] / max(sums[29], 1.0))
            history[n, 13] = sums[29] / points.shape[0]
            # A start may be off by more than the search distance: continue while the weights give a
            # direction.
            if n + 1 == history.shape[0] or not sums[27] > 0.0:
                break
            noise = max(estimate_robust_std(bins, sums[29], reach), floor)
            bend = min(scale, max(_BENDS_AT * noise, _SHRINK * scale))
            if last <= settled and bend > 0.9 * scale:
                break
            # Misfit is not noise before convergence: only the sensor's known error holds
            # directions.
            known = noise if last <= settled else floor
            variance = known * known / max(sums[27], 1.0)
            for k in range(6):
                lasting, per_mm2 = rule[0] if k < 3 else rule[1]
                asked[k] = rule[2] + (variance + lasting) * per_mm2
            solve_step(sums, asked, work, motion)
            scale = bend
            last = apply_motion(poses, start, motion, radius, reach)
            n += 1
        ended[start, 0] = n + 1
        ended[start, 1] = scale
