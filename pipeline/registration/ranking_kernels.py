# pyright: basic
"""Compiled loops of the ranking: what a placed object leaves unexplained of a touch, point by point.

Everything runs on one thread and adds up in the order of the points.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.geometry.distance_grid_kernels import look_up

_FACING = -0.1  # largest cosine, object's normal to felt normal, below which a match is the far side of a thin wall
_NEAREST_MM = 1e-6  # before the camera


@njit(cache=True)
def felt_squares(pose, felt, felt_normals, grid, limit, out):
    """Squared distance, at most limit^2, of each felt point to the placed object; the limit on its far side."""
    origin, step, shape, coarse, block, fine, quantum = grid
    r00, r01, r02, t0 = pose[0, 0], pose[0, 1], pose[0, 2], pose[0, 3]
    r10, r11, r12, t1 = pose[1, 0], pose[1, 1], pose[1, 2], pose[1, 3]
    r20, r21, r22, t2 = pose[2, 0], pose[2, 1], pose[2, 2], pose[2, 3]
    total = 0.0
    for k in range(felt.shape[0]):
        x, y, z = felt[k, 0] - t0, felt[k, 1] - t1, felt[k, 2] - t2
        d, gx, gy, gz = look_up(
            r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z,
            origin, step, shape, coarse, block, fine, quantum,
        )  # fmt: skip
        facing = felt_normals[k, 0] * (r00 * gx + r01 * gy + r02 * gz)
        facing += felt_normals[k, 1] * (r10 * gx + r11 * gy + r12 * gz)
        facing += felt_normals[k, 2] * (r20 * gx + r21 * gy + r22 * gz)
        out[k] = d * d if abs(d) < limit and facing > _FACING else limit * limit
        total += out[k]
    return total / max(felt.shape[0], 1)


@njit(cache=True)
def unfelt_squares(pose, points, normals, camera, membrane, off_contact, free, beside, limit, out, pixel):
    """Squared length, at most limit^2, by which each point should have been felt but was not, and its pixel if so."""
    fx, fy, cx, cy = camera
    rows, cols = membrane.shape
    r00, r01, r02, t0 = pose[0, 0], pose[0, 1], pose[0, 2], pose[0, 3]
    r10, r11, r12, t1 = pose[1, 0], pose[1, 1], pose[1, 2], pose[1, 3]
    r20, r21, r22, t2 = pose[2, 0], pose[2, 1], pose[2, 2], pose[2, 3]
    total = 0.0
    for k in range(points.shape[0]):
        out[k] = 0.0
        # A face turned away is not felt, however near.
        if r20 * normals[k, 0] + r21 * normals[k, 1] + r22 * normals[k, 2] >= 0.0:
            continue
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        pz = r20 * x + r21 * y + r22 * z + t2
        if not pz > _NEAREST_MM:
            continue
        col = fx * (r00 * x + r01 * y + r02 * z + t0) / pz + cx + 0.5
        row = fy * (r10 * x + r11 * y + r12 * z + t1) / pz + cy + 0.5
        if not (0.0 <= col < cols and 0.0 <= row < rows):
            continue
        i, j = int(row), int(col)
        reach = membrane[i, j] - pz
        if reach > 0.0:  # not where the membrane has no reading: nothing is known there
            wrong = min(max(reach - free, off_contact[i, j] - beside, 0.0), limit)
            out[k], pixel[k] = wrong * wrong, i * cols + j
            total += out[k]
    return total / max(points.shape[0], 1)


@njit(cache=True)
def sums(poses, felt, felt_normals, grid, points, normals, camera, membrane, off_contact, free, beside, limit):
    """(n, 2) mean squares of each pose (n, 4, 4): of the felt points, and of the object's points."""
    out = np.zeros((poses.shape[0], 2))
    of_felt, of_points = np.empty(felt.shape[0]), np.empty(points.shape[0])
    pixel = np.zeros(points.shape[0], np.int64)
    for n in range(poses.shape[0]):
        out[n, 0] = felt_squares(poses[n], felt, felt_normals, grid, limit, of_felt)
        out[n, 1] = unfelt_squares(
            poses[n], points, normals, camera, membrane, off_contact, free, beside, limit, of_points, pixel
        )  # fmt: skip
    return out


@njit(cache=True)
def unfelt_by_place(pose, points, normals, camera, membrane, off_contact, free, beside, limit, side, across):
    """(tiles,) sums of the object's squares over tiles of `side` pixels, `across` in a row: to pair two poses."""
    square, pixel = np.empty(points.shape[0]), np.zeros(points.shape[0], np.int64)
    unfelt_squares(pose, points, normals, camera, membrane, off_contact, free, beside, limit, square, pixel)
    rows, cols = membrane.shape
    out = np.zeros(across * (int(rows / side) + 1))
    for k in range(square.size):
        if square[k] > 0.0:
            out[int((pixel[k] // cols) / side) * across + int((pixel[k] % cols) / side)] += square[k]
    return out


@njit(cache=True)
def in_reach(pose, points, normals, low, high, toward, least):
    """Which points, placed, lie in the box from `low` to `high` and face `toward` by at least a cosine."""
    out = np.zeros(points.shape[0], np.bool_)
    for k in range(points.shape[0]):
        inside, facing = True, 0.0
        for i in range(3):
            at = pose[i, 3]
            turned = 0.0
            for j in range(3):
                at += pose[i, j] * points[k, j]
                turned += pose[i, j] * normals[k, j]
            inside = inside and low[i] <= at <= high[i]
            facing += turned * toward[i]
        out[k] = inside and facing > least
    return out
