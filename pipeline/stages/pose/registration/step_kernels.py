# pyright: basic
"""Compiled steps of the registration: the motion that solves the normal equations, and the pose
after it.

Nothing is allocated here: work arrays are arguments. Decompositions are written out: six by six,
they take a third of the time of `np.linalg`'s and a tenth of its compilation.
"""

from __future__ import annotations

import math

from pipeline.core.cached_kernels import inner_kernel, kernel

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
