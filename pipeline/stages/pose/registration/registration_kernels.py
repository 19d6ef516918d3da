# pyright: basic
"""Compiled loops of the registration: robust Gauss-Newton on signed distances, where undetermined
directions are held, and what a placed object leaves unexplained of a touch, point by point.

Everything runs on one thread and adds up in the order of the points, so that results are
reproducible. Steps of the registration allocate nothing: work arrays are arguments. Decompositions
are written out: six by six, they take a third of the time of `np.linalg`'s and a tenth of its
compilation.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.core.cached_kernels import inner_kernel, kernel
from pipeline.core.geometry.distance_grid_kernels import look_up

_MOST_TURN_RAD = 0.3  # largest rotation of one step, within which the linearisation holds
_DAMPING = 1e-9  # share of the trace (methods 5.3)
# sweeps of Jacobi's method, and squared rounding that ends them, after six or seven
_SWEEPS = 30
_ROUNDING = 1e-30


@inner_kernel()
def factorise(low):
    """Cholesky factorisation of the lower triangle in place.

    Returns whether the matrix is positive definite.
    """
    for i in range(low.shape[0]):
        for j in range(i + 1):
            left = low[i, j]
            for k in range(j):
                left -= low[i, k] * low[j, k]
            if i != j:
                low[i, j] = left / low[j, j]
            elif left > 0.0:
                low[i, i] = math.sqrt(left)
            else:
                return False
    return True


@inner_kernel()
def compute_eigenvectors(a, vectors):
    """Compute eigenvectors (columns of `vectors`) and eigenvalues (diagonal) of the symmetric `a`
    by Jacobi rotations.
    """
    n = a.shape[0]
    for p in range(n):
        for q in range(n):
            vectors[p, q] = 1.0 if p == q else 0.0
    for _sweep in range(_SWEEPS):
        off = 0.0
        size = 0.0
        for p in range(n):
            size += a[p, p] * a[p, p]
            for q in range(p):
                off += a[p, q] * a[p, q]
        if off <= _ROUNDING * size:
            break
        for p in range(n - 1):
            for q in range(p + 1, n):
                if a[p, q] == 0.0:
                    continue
                theta = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                t = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1.0))
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for k in range(n):
                    x = a[k, p]
                    y = a[k, q]
                    a[k, p] = c * x - s * y
                    a[k, q] = s * x + c * y
                    x = vectors[k, p]
                    y = vectors[k, q]
                    vectors[k, p] = c * x - s * y
                    vectors[k, q] = s * x + c * y
                for k in range(n):
                    x = a[p, k]
                    y = a[q, k]
                    a[p, k] = c * x - s * y
                    a[q, k] = s * x + c * y


@kernel()
def solve_step(sums, asked, work, motion):
    """Return how many directions are held; `motion` (6,) becomes the step along the others.

    A motion v is held where v^T H v / weight < v^T diag(asked) v
    (`pipeline.stages.pose.registration.observability`); the step is orthogonal to it in that form,
    so that rotations need not be weighed against translations.
    """
    low, vectors = work
    weight = sums[27]
    total = 0.0
    at = 0
    for i in range(6):
        for j in range(i, 6):
            low[j, i] = low[i, j] = sums[at] / weight
            at += 1
        total += low[i, i]
        low[i, i] -= asked[i]
        motion[i] = sums[21 + i] / weight
    certain = factorise(low)
    at = 0
    for i in range(6):
        for j in range(i, 6):
            low[j, i] = low[i, j] = sums[at] / weight
            at += 1
        low[i, i] += _DAMPING * total if certain else 0.0
    if certain and factorise(low):
        for i in range(6):
            for k in range(i):
                motion[i] -= low[i, k] * motion[k]
            motion[i] /= low[i, i]
        for i in range(5, -1, -1):
            for k in range(i + 1, 6):
                motion[i] -= low[k, i] * motion[k]
            motion[i] /= low[i, i]
        return 0
    return _held_step(low, vectors, asked, motion)


@inner_kernel()
def _held_step(h, vectors, asked, motion):
    for i in range(6):
        for j in range(6):
            h[i, j] /= math.sqrt(asked[i] * asked[j])
    compute_eigenvectors(h, vectors)
    n_held = 0
    for k in range(6):
        along = 0.0
        for i in range(6):
            along += vectors[i, k] * motion[i] / math.sqrt(asked[i])
        # What one direction asks for waits on the diagonal, which has no other use now.
        if h[k, k] < 1.0:
            n_held += 1
            h[k, k] = 0.0
        else:
            h[k, k] = along / h[k, k]
    for i in range(6):
        motion[i] = 0.0
        for k in range(6):
            motion[i] += vectors[i, k] * h[k, k] / math.sqrt(asked[i])
    return n_held


@inner_kernel()
def apply_motion(poses, n, motion, radius, most):
    """Apply a motion of the object's axes about the centroid to pose n of rows (rotation,
    translation); return its size (mm).
    """
    wx = motion[0] / radius
    wy = motion[1] / radius
    wz = motion[2] / radius
    angle = math.sqrt(wx * wx + wy * wy + wz * wz)
    slide = math.sqrt(motion[3] * motion[3] + motion[4] * motion[4] + motion[5] * motion[5])
    factor = min(1.0, _MOST_TURN_RAD / max(angle, 1e-300), most / max(slide, 1e-300))
    wx = wx * factor
    wy = wy * factor
    wz = wz * factor
    full = angle * factor
    a = math.sin(full) / full if full > 1e-4 else 1.0 - full * full / 6.0
    b = (1.0 - math.cos(full)) / (full * full) if full > 1e-4 else 0.5 - full * full / 24.0
    # In the object's axes the centroid is at -R^T t; the points move to E^T (x - v), so R' = R E.
    x = (
        -factor * motion[3]
        - poses[n, 0] * poses[n, 9]
        - poses[n, 3] * poses[n, 10]
        - poses[n, 6] * poses[n, 11]
    )
    y = (
        -factor * motion[4]
        - poses[n, 1] * poses[n, 9]
        - poses[n, 4] * poses[n, 10]
        - poses[n, 7] * poses[n, 11]
    )
    z = (
        -factor * motion[5]
        - poses[n, 2] * poses[n, 9]
        - poses[n, 5] * poses[n, 10]
        - poses[n, 8] * poses[n, 11]
    )
    for i in range(3):
        u = poses[n, 3 * i]
        v = poses[n, 3 * i + 1]
        w = poses[n, 3 * i + 2]
        # A row r of R times E = 1 + a [w] + b [w]^2 is r - a (w x r) + b (w (w . r) - r w^2).
        dot = wx * u + wy * v + wz * w
        square = wx * wx + wy * wy + wz * wz
        poses[n, 3 * i] = u - a * (wy * w - wz * v) + b * (wx * dot - u * square)
        poses[n, 3 * i + 1] = v - a * (wz * u - wx * w) + b * (wy * dot - v * square)
        poses[n, 3 * i + 2] = w - a * (wx * v - wy * u) + b * (wz * dot - w * square)
        poses[n, 9 + i] = -(poses[n, 3 * i] * x + poses[n, 3 * i + 1] * y + poses[n, 3 * i + 2] * z)
    return math.sqrt(angle * angle * radius * radius + slide * slide)


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


# cosine of object's and contact normal, below which a match is the far side of a thin wall
_FACING = -0.1
_NEAREST_MM = 1e-6  # before the camera


@inner_kernel()
def _measure_contact(poses, n, contact, contact_normals, grid, limit, out):
    """Mean squared distance, at most limit^2, of contact points to the placed object.

    The limit on its far side.
    """
    r00 = poses[n, 0, 0]
    r01 = poses[n, 0, 1]
    r02 = poses[n, 0, 2]
    t0 = poses[n, 0, 3]
    r10 = poses[n, 1, 0]
    r11 = poses[n, 1, 1]
    r12 = poses[n, 1, 2]
    t1 = poses[n, 1, 3]
    r20 = poses[n, 2, 0]
    r21 = poses[n, 2, 1]
    r22 = poses[n, 2, 2]
    t2 = poses[n, 2, 3]
    total = 0.0
    for k in range(contact.shape[0]):
        x = contact[k, 0] - t0
        y = contact[k, 1] - t1
        z = contact[k, 2] - t2
        d, gx, gy, gz = look_up(
            r00 * x + r10 * y + r20 * z,
            r01 * x + r11 * y + r21 * z,
            r02 * x + r12 * y + r22 * z,
            grid,
        )
        facing = contact_normals[k, 0] * (r00 * gx + r01 * gy + r02 * gz)
        facing += contact_normals[k, 1] * (r10 * gx + r11 * gy + r12 * gz)
        facing += contact_normals[k, 2] * (r20 * gx + r21 * gy + r22 * gz)
        out[k] = d * d if abs(d) < limit and facing > _FACING else limit * limit
        total += out[k]
    return total / max(contact.shape[0], 1)


@inner_kernel()
def _measure_free_space(poses, n, model, view, limit, out, pixel):
    """Mean squared length, at most limit^2, of model points that should touch but do not.

    And their pixels.
    """
    points, normals = model
    fx, fy, cx, cy, noise, free, outside, membrane, off_contact = view
    rows, cols = membrane.shape
    r00 = poses[n, 0, 0]
    r01 = poses[n, 0, 1]
    r02 = poses[n, 0, 2]
    t0 = poses[n, 0, 3]
    r10 = poses[n, 1, 0]
    r11 = poses[n, 1, 1]
    r12 = poses[n, 1, 2]
    t1 = poses[n, 1, 3]
    r20 = poses[n, 2, 0]
    r21 = poses[n, 2, 1]
    r22 = poses[n, 2, 2]
    t2 = poses[n, 2, 3]
    total = 0.0
    for k in range(points.shape[0]):
        out[k] = 0.0
        pixel[k] = 0
        # A face turned away cannot touch.
        if r20 * normals[k, 0] + r21 * normals[k, 1] + r22 * normals[k, 2] >= 0.0:
            continue
        x = points[k, 0]
        y = points[k, 1]
        z = points[k, 2]
        pz = r20 * x + r21 * y + r22 * z + t2
        if not pz > _NEAREST_MM:
            continue
        col = fx * (r00 * x + r01 * y + r02 * z + t0) / pz + cx + 0.5
        row = fy * (r10 * x + r11 * y + r12 * z + t1) / pz + cy + 0.5
        if not (0.0 <= col < cols and 0.0 <= row < rows):
            continue
        i = int(row)
        j = int(col)
        reach = membrane[i, j] - pz
        if reach > noise:  # unknown where the membrane has no depth
            wrong = min(max(reach - free, off_contact[i, j] - outside, 0.0), limit)
            out[k] = wrong * wrong
            pixel[k] = i * cols + j
            total += out[k]
    return total / max(points.shape[0], 1)


@kernel()
def measure_unexplained(poses, contact, contact_normals, grid, model, view, limit, means, last):
    """Write `means` (n, 2) squares of each pose (n, 4, 4): of contact points and of model points.

    `last`: each point's.

    `model` is points and normals; `view` the camera, the noise of the membrane toward an object,
    how far an object may be before it and outside the contact, the membrane, and each pixel's
    distance off the contact; `last` the squares of contact points and model points, and the
    latter's pixels.
    """
    of_felt, of_points, pixel = last
    for n in range(poses.shape[0]):
        means[n, 0] = _measure_contact(poses, n, contact, contact_normals, grid, limit, of_felt)
        means[n, 1] = _measure_free_space(poses, n, model, view, limit, of_points, pixel)


@kernel()
def search_pattern(best, motions, most, area_ratio, inputs, last):
    """Move the pose `best` (4, 4) in place to less misfit, by pattern search.

    motions (sizes, n, 4, 4) of the sensor frame: the best one of a size is followed as long as it
    helps, then the next size is tried; at most `most` rounds. inputs: of `measure_unexplained`
    after its poses.
    """
    contact, contact_normals, grid, model, view, limit = inputs
    n = motions.shape[1]
    tried = np.empty((n, 4, 4))
    tried[:1] = best
    means = np.empty((n, 2))
    measure_unexplained(tried[:1], contact, contact_normals, grid, model, view, limit, means, last)
    least = math.sqrt(means[0, 0] + means[0, 1] * area_ratio)
    size = 0
    for _ in range(most):
        for k in range(n):
            for i in range(4):
                for j in range(4):
                    tried[k, i, j] = 0.0
                    for m in range(4):
                        tried[k, i, j] += motions[size, k, i, m] * best[m, j]
        measure_unexplained(tried, contact, contact_normals, grid, model, view, limit, means, last)
        chosen = -1
        for k in range(n):
            misfit = math.sqrt(means[k, 0] + means[k, 1] * area_ratio)
            if misfit < least:
                least = misfit
                chosen = k
        if chosen >= 0:
            best[:] = tried[chosen]
            continue
        size += 1
        if size == motions.shape[0]:
            return
