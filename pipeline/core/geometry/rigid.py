"""Rigid transforms SE(3) as 4x4 matrices in millimetres, composed in float64.

`target_from_source` maps points given in the source frame to the target frame: `target_from_source
= target_from_alignment @ alignment_from_source`.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from pipeline.core.arrays import Doubles
from pipeline.core.errors import CalibrationError

# largest entry of R^T R - I; float32 files keep 1e-6, hand-typed ones less
ORTHONORMAL_TOLERANCE = 1e-5
# between two sensors that feel the same touch, or one and what it touches
MAX_TRANSLATION_MM = 1000.0
_STRAIGHT_RAD = 1e-9  # a smaller rotation is a translation within rounding
_SMALL_ANGLE_RAD = 1e-4  # below it the series is exact to double precision


def translation(x_mm: float, y_mm: float, z_mm: float) -> Doubles:
    """A pure shift."""
    matrix = np.eye(4)
    matrix[:3, 3] = (x_mm, y_mm, z_mm)
    return matrix


def rotation(rotation_vector_rad: ArrayLike) -> Doubles:
    """The rotations (..., 4, 4) about vectors (..., 3) by their lengths in radians (exponential
    map, Rodrigues).
    """
    w = np.asarray(rotation_vector_rad, dtype=np.float64)
    angle = np.sqrt((w * w).sum(axis=-1))[..., None, None]
    k = cross_matrix(w)
    small = angle < _SMALL_ANGLE_RAD
    safe = np.maximum(angle, _SMALL_ANGLE_RAD)
    a = np.where(small, 1.0 - angle**2 / 6.0, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    matrix = np.zeros((*w.shape[:-1], 4, 4))
    matrix[..., range(4), range(4)] = 1.0
    matrix[..., :3, :3] += a * k + b * (k @ k)
    return matrix


def cross_matrix(vectors: Doubles) -> Doubles:
    """The matrices (..., 3, 3) that multiply as the cross product with vectors (..., 3)."""
    matrix = np.zeros((*vectors.shape, 3))
    matrix[..., (2, 0, 1), (1, 2, 0)] = vectors
    matrix[..., (1, 2, 0), (2, 0, 1)] = -vectors
    return matrix


def rotation_vector_rad(matrix: ArrayLike) -> Doubles:
    """The rotation vector (3,) of a transform: logarithm by way of the quaternion, exact at 0
    and at pi.
    """
    r = np.asarray(matrix, dtype=np.float64)[:3, :3]
    # Four times a quaternion times each of its components, in rows (Shepperd 1978): the longest
    # row needs no division by ~0.
    trace, diagonal = np.trace(r), np.diag(r)
    skew = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    rows = np.empty((4, 4))
    rows[0] = rows[:, 0] = 1.0 + trace, *skew
    rows[1:, 1:] = r + r.T
    rows[range(1, 4), range(1, 4)] = 1.0 - trace + 2.0 * diagonal
    return _convert_quaternion(rows[np.argmax(np.diag(rows))])


def _convert_quaternion(wxyz: Doubles) -> Doubles:
    """The rotation vector (3,) of a quaternion of any length, by the shorter way round."""
    q = wxyz / np.linalg.norm(wxyz)
    q = -q if q[0] < 0 else q
    sine = float(np.linalg.norm(q[1:]))
    scale = 2.0 if sine < _SMALL_ANGLE_RAD**2 else 2.0 * math.atan2(sine, q[0]) / sine
    return np.asarray(q[1:] * scale)


def from_parts(translation_mm: ArrayLike, rotation_deg: ArrayLike = (0.0, 0.0, 0.0)) -> Doubles:
    """Return a transform from a translation and a rotation vector in degrees, as in alignment
    files.
    """
    matrix = rotation(np.deg2rad(np.asarray(rotation_deg, dtype=np.float64)))
    matrix[:3, 3] = np.asarray(translation_mm, dtype=np.float64)
    return matrix


def from_quaternion(translation_mm: ArrayLike, xyzw: ArrayLike) -> Doubles:
    """Return a transform from a translation and a quaternion (x, y, z, w).

    CalibrationError for length 0.
    """
    q = np.asarray(xyzw, dtype=np.float64)
    largest = float(np.abs(q).max())
    if not 0.0 < largest < math.inf:
        raise CalibrationError(f"a rotation quaternion must have a length, got {tuple(q.tolist())}")
    # only its direction counts; squares neither overflow nor vanish
    matrix = rotation(_convert_quaternion(np.roll(q / largest, 1)))
    matrix[:3, 3] = np.asarray(translation_mm, dtype=np.float64)
    return matrix


def invert(matrix: Doubles) -> Doubles:
    """Return the inverse transform."""
    inverse = np.eye(4)
    inverse[:3, :3] = matrix[:3, :3].T
    inverse[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return inverse


def orthonormalise(matrix: Doubles) -> Doubles:
    """The nearest rigid transform (4, 4): products of many lose their orthonormality."""
    u, _, vt = np.linalg.svd(matrix[:3, :3])
    rigid = matrix.copy()
    rigid[:3, :3] = u @ vt
    return rigid


def apply(target_from_source: Doubles, points_mm: ArrayLike) -> Doubles:
    """Transform points (..., 3) from the source frame to the target frame (float64)."""
    points = np.asarray(points_mm, dtype=np.float64)
    return np.asarray(points @ target_from_source[:3, :3].T + target_from_source[:3, 3])


def rotation_angle_deg(matrix: Doubles) -> float:
    """Return the angle of a transform's rotation."""
    return math.degrees(float(np.linalg.norm(rotation_vector_rad(matrix))))


def apply_screw(pose: Doubles, motions: Doubles, about_mm: Doubles) -> Doubles:
    """Return `pose` (..., 4, 4) after screw motions (..., 6), rotation rad and translation mm, of
    the sensor frame.

    The full screw is followed, so a body of revolution rotated about its own axis stays in place at
    any distance.
    """
    vectors = motions[..., :3]
    shifts = motions[..., 3:]
    angles = np.linalg.norm(vectors, axis=-1, keepdims=True)
    safe = np.where(angles > _STRAIGHT_RAD, angles, 1.0)
    axes = np.where(angles > _STRAIGHT_RAD, vectors, 0.0) / safe
    across = np.cross(axes, shifts)
    bent = ((1 - np.cos(safe)) * across + (safe - np.sin(safe)) * np.cross(axes, across)) / safe
    turned = rotation(vectors)
    turned[..., :3, 3] = about_mm - turned[..., :3, :3] @ about_mm + shifts + bent
    return turned @ pose


def poses_differ(a: Doubles, b: Doubles, at_mm: Doubles, mm: float, deg: float) -> bool:
    """Return whether two poses differ by more than `mm` at a point of the sensor frame, or by
    more than `deg`.
    """
    relative = a @ invert(b)
    return bool(
        np.linalg.norm(apply(relative, at_mm) - at_mm) > mm or rotation_angle_deg(relative) > deg
    )


def validate_within_reach(matrix: ArrayLike, what: str) -> Doubles:
    """Validate a rigid transform with a plausible translation, from a file.

    Raises CalibrationError.
    """
    m = validate_rigid(matrix, what)
    far = float(np.abs(m[:3, 3]).max())
    if far > MAX_TRANSLATION_MM:
        raise CalibrationError(
            f"{what} translates by {far:.3g} mm, it must lie within {MAX_TRANSLATION_MM:g} mm"
        )
    return m


def validate_rigid(matrix: ArrayLike, what: str) -> Doubles:
    """Return `matrix` as a proper rigid transform, its rotation exactly orthonormal.

    `what` names it in errors.

    Raises CalibrationError when it is not 4x4, not finite, mirrored, scaled or sheared.
    """
    m = np.array(matrix, dtype=np.float64)
    if m.shape != (4, 4):
        raise CalibrationError(f"{what} must be a 4x4 matrix, got shape {m.shape}")
    if not np.isfinite(m).all():
        raise CalibrationError(f"{what} holds a value that is not finite")
    if np.abs(m[3] - (0.0, 0.0, 0.0, 1.0)).max() > ORTHONORMAL_TOLERANCE:
        raise CalibrationError(f"the last row of {what} must be 0 0 0 1, got {m[3].tolist()}")
    u, s, vt = np.linalg.svd(m[:3, :3])
    determinant = float(np.linalg.det(m[:3, :3]))
    if determinant < 0:
        raise CalibrationError(
            f"{what} mirrors space (determinant {determinant:.3f}); swap or flip one axis"
        )
    if np.abs(s - 1.0).max() > ORTHONORMAL_TOLERANCE:
        raise CalibrationError(
            f"{what} must not scale or shear (singular values {np.round(s, 6).tolist()})"
        )
    m[:3, :3] = u @ vt
    m[3] = (0.0, 0.0, 0.0, 1.0)
    return m
