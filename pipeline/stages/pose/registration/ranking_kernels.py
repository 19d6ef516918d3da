# pyright: basic
"""Compiled loops of the ranking: what a placed object leaves unexplained of a touch, point by
point.

Everything runs on one thread and adds up in the order of the points.
"""

from __future__ import annotations

from pipeline.core.cached_kernels import inner_kernel, kernel
from pipeline.core.geometry.distance_grid_kernels import look_up

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
