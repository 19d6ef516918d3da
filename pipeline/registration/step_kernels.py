# pyright: basic
"""Compiled steps of the registration: what the points determine, the motion that follows, and the pose after it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

_MOST_TURN_RAD = 0.3
_DAMPING = 1e-9


@njit(cache=True)
def eigen(matrix):
    """(values (6,), vectors (6, 6) in columns) of a symmetric matrix, by Jacobi's rotations."""
    a, v = matrix.copy(), np.eye(6)
    for _sweep in range(30):
        off, size = 0.0, 0.0
        for p in range(6):
            size += a[p, p] * a[p, p]
            for q in range(p):
                off += a[p, q] * a[p, q]
        if off <= 1e-30 * size:
            break
        for p in range(5):
            for q in range(p + 1, 6):
                if a[p, q] == 0.0:
                    continue
                theta = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                t = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1.0))
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for k in range(6):
                    x, y = a[k, p], a[k, q]
                    a[k, p], a[k, q] = c * x - s * y, s * x + c * y
                for k in range(6):
                    x, y = a[p, k], a[q, k]
                    a[p, k], a[q, k] = c * x - s * y, s * x + c * y
                    x, y = v[k, p], v[k, q]
                    v[k, p], v[k, q] = c * x - s * y, s * x + c * y
    return np.diag(a).copy(), v


@njit(cache=True)
def hessian(sums):
    """(6, 6) from the upper triangle in `sums`."""
    out = np.empty((6, 6))
    k = 0
    for i in range(6):
        for j in range(i, 6):
            out[i, j] = out[j, i] = sums[k]
            k += 1
    return out


@njit(cache=True)
def cholesky(matrix):
    """(lower triangle, whether the matrix is positive definite)."""
    n = matrix.shape[0]
    low = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            left = matrix[i, j]
            for k in range(j):
                left -= low[i, k] * low[j, k]
            if i != j:
                low[i, j] = left / low[j, j]
            elif left > 0.0:
                low[i, i] = math.sqrt(left)
            else:
                return low, False
    return low, True


@njit(cache=True)
def solved(low, right):
    """x of L L^T x = right."""
    n, x = right.size, right.copy()
    for i in range(n):
        for k in range(i):
            x[i] -= low[i, k] * x[k]
        x[i] /= low[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= low[k, i] * x[k]
        x[i] /= low[i, i]
    return x


@njit(cache=True)
def weak_directions(information, fake, turn, shift):
    """Orthonormal columns (6, k): the motions that the points see less of than is asked for.

    The rule of `pipeline.registration.observability.observable_part`: asked for is `fake` of what is not seen, and
    `turn` and `shift` of turns and shifts.
    """
    asked = np.eye(6) * fake
    for k in range(6):
        asked[k, k] += turn if k < 3 else shift
    # Nothing can be hidden by more than all of it: where this much is seen, no closer look is needed.
    if cholesky(information - asked)[1]:
        return np.zeros((6, 0))
    asked += fake * (_hidden(information) - np.eye(6))
    low, positive = cholesky(asked)
    if not positive:
        return np.eye(6)
    whiten = np.empty((6, 6))  # L^-T: takes what is asked for to the same in all directions
    for k in range(6):
        unit = np.zeros(6)
        unit[k] = 1.0
        for i in range(6):
            for j in range(i):
                unit[i] -= low[i, j] * unit[j]
            unit[i] /= low[i, i]
        whiten[k] = unit
    seen, directions = eigen(whiten.T @ information @ whiten)
    return _orthonormal_columns((whiten @ directions)[:, seen < 1.0])


@njit(cache=True)
def _hidden(information):
    """What is not seen of all: identity less information, as far as that is positive."""
    hidden = np.eye(6) - information
    if cholesky(hidden)[1]:
        return hidden
    values, vectors = eigen(hidden)
    hidden[:] = 0.0
    for k in range(6):
        if values[k] > 0.0:
            hidden += values[k] * np.outer(vectors[:, k], vectors[:, k])
    return hidden


@njit(cache=True)
def _orthonormal_columns(columns):
    out = columns.copy()
    for _twice in range(2):
        for j in range(out.shape[1]):
            for k in range(j):
                out[:, j] -= (out[:, j] * out[:, k]).sum() * out[:, k]
            out[:, j] /= math.sqrt((out[:, j] ** 2).sum())
    return out


@njit(cache=True)
def step(sums, noise, independent, radius, tolerance_mm, tolerance_rad, normal_error_rad):
    """(motion (6,), hessian, weak directions (6, k)): what is weak does not move."""
    h, gradient = hessian(sums), sums[21:27].copy()
    weight = sums[27]
    variance = noise * noise / max(weight * independent, 1.0)
    weak = weak_directions(
        h / weight, normal_error_rad**2, variance / (tolerance_rad * radius) ** 2, variance / tolerance_mm**2
    )  # fmt: skip
    total = np.trace(h)
    held = h.copy()
    if weak.shape[1]:
        keep = np.eye(6) - weak @ weak.T
        held = keep @ h @ keep + total * (weak @ weak.T)
        gradient = keep @ gradient
    for k in range(6):
        held[k, k] += _DAMPING * total
    low, positive = cholesky(held)
    if not positive:
        return np.zeros(6), h, np.eye(6)
    return solved(low, gradient), h, weak


@njit(cache=True)
def move(turn, shift, motion, radius, most):
    """Pose (in place) after a motion of the object's axes about the points' middle; returns the motion's size, mm."""
    wx, wy, wz = motion[0] / radius, motion[1] / radius, motion[2] / radius
    angle = math.sqrt(wx * wx + wy * wy + wz * wz)
    slide = math.sqrt(motion[3] ** 2 + motion[4] ** 2 + motion[5] ** 2)
    factor = min(1.0, _MOST_TURN_RAD / max(angle, 1e-300), most / max(slide, 1e-300))
    wx, wy, wz, angle = wx * factor, wy * factor, wz * factor, angle * factor
    a = math.sin(angle) / angle if angle > 1e-4 else 1.0 - angle * angle / 6.0
    b = (1.0 - math.cos(angle)) / (angle * angle) if angle > 1e-4 else 0.5 - angle * angle / 24.0
    e = np.empty((3, 3))
    e[0, 0], e[0, 1], e[0, 2] = 1 - b * (wy * wy + wz * wz), b * wx * wy - a * wz, b * wx * wz + a * wy
    e[1, 0], e[1, 1], e[1, 2] = b * wx * wy + a * wz, 1 - b * (wx * wx + wz * wz), b * wy * wz - a * wx
    e[2, 0], e[2, 1], e[2, 2] = b * wx * wz - a * wy, b * wy * wz + a * wx, 1 - b * (wx * wx + wy * wy)
    # In the object's axes the middle is at -R^T t; the points' new place there is E^T (x - v), so R' = R E.
    old, middle, new = turn.copy(), np.zeros(3), np.zeros((3, 3))
    for i in range(3):
        for k in range(3):
            middle[i] -= old[k, i] * shift[k]
            for j in range(3):
                new[i, j] += old[i, k] * e[k, j]
    for i in range(3):
        middle[i] -= factor * motion[3 + i]
    for i in range(3):
        shift[i] = 0.0
        for j in range(3):
            turn[i, j] = new[i, j]
            shift[i] -= new[i, j] * middle[j]
    return math.sqrt((motion**2).sum())


@njit(cache=True)
def orthonormal(turn):
    """Rows made orthonormal again (in place): products of rotations drift by rounding."""
    for i in range(3):
        for j in range(i):
            dot = turn[i, 0] * turn[j, 0] + turn[i, 1] * turn[j, 1] + turn[i, 2] * turn[j, 2]
            for k in range(3):
                turn[i, k] -= dot * turn[j, k]
        norm = math.sqrt(turn[i, 0] ** 2 + turn[i, 1] ** 2 + turn[i, 2] ** 2)
        for k in range(3):
            turn[i, k] /= norm


@njit(cache=True)
def centre(points):
    """((n, 3) points about their middle, middle, rms distance from it); those that are not finite are left out."""
    n, middle = 0, np.zeros(3)
    first = np.zeros(3)
    for k in range(points.shape[0]):
        if math.isfinite(points[k, 0]) and math.isfinite(points[k, 1]) and math.isfinite(points[k, 2]):
            if n == 0:
                first[:] = points[k]
            # Summed from the first point on, so that a frame far away costs no digits.
            for i in range(3):
                middle[i] += points[k, i] - first[i]
            n += 1
    for i in range(3):
        middle[i] = first[i] + middle[i] / max(n, 1)
    out, squares, n = np.empty((n, 3)), 0.0, 0
    for k in range(points.shape[0]):
        if math.isfinite(points[k, 0]) and math.isfinite(points[k, 1]) and math.isfinite(points[k, 2]):
            for i in range(3):
                out[n, i] = points[k, i] - middle[i]
                squares += out[n, i] ** 2
            n += 1
    return out, middle, math.sqrt(squares / max(n, 1))
