"""Surface normals and areas of images of points."""

import numpy as np

from pipeline.core.arrays import Doubles, Mask, Reals


def compute_area_vectors(points_mm: Reals) -> Doubles:
    """Return the normals of an image of points (rows, cols, 3), toward the camera, with the pixel's
    area as length.

    Unknown neighbours (NaN) are left out; NaN where a point has none to its sides, or none above
    and below.
    """
    to_right, down = (_slope(points_mm, axis) for axis in (1, 0))
    return np.cross(down, to_right)  # y cross x points to -z: toward a camera that looks along +z


def _slope(points: Reals, axis: int) -> Doubles:
    """Return the change per pixel along `axis`: the mean of both steps, or the only one known."""
    step = np.diff(points, axis=axis)
    gap = np.full_like(np.take(points, [0], axis=axis), np.nan)
    after = np.concatenate([step, gap], axis=axis)
    before = np.concatenate([gap, step], axis=axis)
    known_after = _is_finite(after)
    known_before = _is_finite(before)
    total = np.where(known_after[..., None], after, 0.0) + np.where(
        known_before[..., None], before, 0.0
    )
    count = known_after.astype(np.float64) + known_before
    return total / np.where(count > 0, count, np.nan)[..., None]


def _is_finite(vectors: Reals) -> Mask:
    return np.isfinite(vectors[..., 2])
