"""Rotations at nothing, near it, at half a turn and near that; transforms at all sizes of shift."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from pipeline.core.geometry import rigid
from tests.stability.checks import outcome
from tests.stability.rows import row
from tests.stability.scenes import rigid_motions, unit_numbers

EPS = np.finfo(np.float64).eps
LENGTHS_RAD = (0.0, 1e-300, 5e-324, 1e-12, 1e-8, 1e-4, np.pi - 1e-4, np.pi - 1e-9, np.pi)
# at a half turn the matrix says the axis to the root of nothing better than its own last bits
ANGLE_RAD = 1e-11

directions = st.tuples(unit_numbers, unit_numbers, unit_numbers).filter(
    lambda v: np.linalg.norm(v) > 1e-3
)
lengths_rad = st.one_of(
    st.sampled_from(LENGTHS_RAD), st.floats(0.0, np.pi), st.floats(-300, 0).map(lambda e: 10**e)
)


def vector_of(direction, length_rad):
    return np.asarray(direction) / np.linalg.norm(direction) * length_rad


@row(11, "the logarithm undoes the exponential, from 0 to a half turn")
@given(directions, lengths_rad)
@example((1.0, 0.0, 0.0), np.pi)
@example((0.0, 1.0, 0.0), np.pi - 1e-9)
@example((1.0, 1.0, 1.0), 1e-300)
@example((1.0, -1.0, 0.5), np.pi - 1e-4)
def test_logarithm_undoes_exponential(direction, length_rad):
    vector = vector_of(direction, length_rad)
    back = rigid.rotation_vector_rad(rigid.rotation(vector))
    assert np.isfinite(back).all()
    if np.pi - length_rad < 1e-8:  # half turns either way round are the same rotation
        back = back * np.sign(back @ vector)
    assert np.abs(back - vector).max() <= ANGLE_RAD


@row(11, "small rotations keep their size to the last bits, down to the smallest number")
@given(directions, st.floats(-300, -4).map(lambda e: 10**e))
def test_small_rotations_keep_their_relative_size(direction, length_rad):
    vector = vector_of(direction, length_rad)
    back = rigid.rotation_vector_rad(rigid.rotation(vector))
    assert np.abs(back - vector).max() <= 16 * EPS * length_rad


@row(11, "the exponential undoes the logarithm, and is a rotation")
@given(directions, lengths_rad)
def test_exponential_undoes_logarithm(direction, length_rad):
    matrix = rigid.rotation(vector_of(direction, length_rad))
    again = rigid.rotation(rigid.rotation_vector_rad(matrix))
    assert np.abs(again - matrix).max() <= 32 * EPS
    assert np.abs(matrix[:3, :3].T @ matrix[:3, :3] - np.eye(3)).max() <= 8 * EPS
    assert abs(np.linalg.det(matrix[:3, :3]) - 1.0) <= 16 * EPS


@row(11, "a derivative through the exponential is finite and right at every size")
@given(directions, lengths_rad, directions)
def test_derivative_of_the_exponential(direction, length_rad, along):
    vector = vector_of(direction, length_rad)
    along = vector_of(along, 1.0)
    step = 1e-6
    slope = (rigid.rotation(vector + step * along) - rigid.rotation(vector - step * along)) / (
        2 * step
    )
    assert np.isfinite(slope).all()
    # A turn's point moves no faster than the angle does; central differences add the rounding of R
    # over the step.
    assert np.linalg.norm(slope[:3, :3], 2) <= 1.0 + 8 * EPS / step


@row(11, "a composed and inverted transform leaves what float64 must leave, up to 1e6 mm")
@given(rigid_motions(1.0), rigid_motions(1.0), st.integers(0, 6))
def test_inverse(a, b, power):
    scale = 10.0**power
    a[:3, 3] *= scale
    b[:3, 3] *= scale
    left = rigid.invert(a @ b) @ (a @ b) - np.eye(4)
    # Two rotations that are each orthonormal to 8 eps, and three products of them with three sums
    # an entry.
    assert np.abs(left[:3, :3]).max() <= (2 * 8 + 3 * 3) * EPS
    # Shifts of up to 2 sqrt(3) of the scale, through rotations that are each orthonormal to 8 eps,
    # and three sums.
    assert np.abs(left[:3, 3]).max() <= 96 * EPS * (scale + 1.0)


@row(
    11,
    "what is not rigid is refused in words, what nearly is comes out exactly rigid",
    refused=0.95,
)
@given(
    rigid_motions(1e3),
    st.integers(0, 15),
    st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-320, 1e300, 1e-7, 1e6]),
    st.booleans(),
)
def test_a_damaged_transform(matrix, entry, value, added):
    damaged = matrix.copy()
    damaged.flat[entry] = value + (damaged.flat[entry] if added else 0.0)
    answer, message = outcome(rigid.validate_rigid, damaged, "it")
    if answer is None:
        # What moves a point of the unit sphere by less than the tolerance is no damage, and a shift
        # is any number.
        rigid_enough = (
            np.abs(damaged - matrix)[[0, 1, 2, 3], :3].max() <= 0.1 * rigid.ORTHONORMAL_TOLERANCE
        )
        assert not (rigid_enough and np.isfinite(damaged).all() and damaged[3, 3] == 1), message
        return
    assert np.isfinite(answer).all()
    assert np.abs(answer[:3, :3].T @ answer[:3, :3] - np.eye(3)).max() <= 16 * EPS
    assert np.linalg.det(answer[:3, :3]) > 0


@row(11, "a quaternion of any length gives a rotation or is refused", refused=1.0)
@given(st.tuples(*[st.one_of(st.floats(allow_nan=True, allow_infinity=True), unit_numbers)] * 4))
def test_any_quaternion(xyzw):
    matrix, _ = outcome(rigid.from_quaternion, [1.0, 2.0, 3.0], xyzw)
    assert (matrix is not None) == (bool(np.isfinite(xyzw).all()) and any(xyzw))
    if matrix is not None:
        assert np.abs(matrix[:3, :3].T @ matrix[:3, :3] - np.eye(3)).max() <= 32 * EPS
