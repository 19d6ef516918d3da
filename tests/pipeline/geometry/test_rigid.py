from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pipeline.base.errors import CalibrationError
from pipeline.geometry import rigid

COMPOSED = 1e-12  # a few roundings of float64 on rotations
number = st.floats(-1.0, 1.0)
vectors = st.tuples(number, number, number)
shifts_mm = st.tuples(*[st.floats(-1e3, 1e3)] * 3)
lengths_rad = st.sampled_from([0.0, 1e-300, 1e-12, 1e-8, 0.99e-4, 1.01e-4, 0.5, 2.0, np.pi - 1e-4, np.pi - 1e-9, np.pi])


def unit(vector):
    length = np.linalg.norm(vector)
    return np.array([1.0, 0.0, 0.0]) if length < 1e-3 else np.asarray(vector) / length


@given(vectors, lengths_rad)
def test_logarithm_undoes_the_exponential(direction, length_rad):
    vector = unit(direction) * length_rad
    back = rigid.rotation_vector_rad(rigid.rotation(vector))
    if np.pi - length_rad < 1e-8:  # half turns either way round are the same rotation
        back = back * np.sign(back @ vector)
    # Near a half turn the sine of half the angle is flat: the last bit of the matrix moves the axis, not the angle.
    np.testing.assert_allclose(back, vector, atol=1e-11)
    assert np.isfinite(back).all()


@given(vectors, st.floats(0.0, np.pi))
def test_rotations_are_proper(direction, length_rad):
    r = rigid.rotation(unit(direction) * length_rad)[:3, :3]
    np.testing.assert_allclose(r.T @ r, np.eye(3), atol=COMPOSED)
    assert abs(np.linalg.det(r) - 1.0) < COMPOSED


@given(vectors, st.floats(0.0, np.pi), shifts_mm)
def test_inverse_composes_to_nothing(direction, length_rad, shift_mm):
    move = rigid.from_parts(shift_mm, np.rad2deg(unit(direction) * length_rad))
    np.testing.assert_allclose(rigid.invert(move) @ move, np.eye(4), atol=1e-9)  # mm, of shifts up to 1 m
    np.testing.assert_allclose(
        rigid.apply(rigid.invert(move), rigid.apply(move, [1.0, 2.0, 3.0])), [1, 2, 3], atol=1e-9
    )


@given(vectors, st.floats(0.0, np.pi))
def test_a_quaternion_says_the_same_as_a_rotation_vector(direction, length_rad):
    axis = unit(direction)
    xyzw = [*(axis * np.sin(length_rad / 2)), np.cos(length_rad / 2)]
    expected = rigid.rotation(axis * length_rad)
    np.testing.assert_allclose(rigid.from_quaternion([0, 0, 0], xyzw), expected, atol=COMPOSED)
    np.testing.assert_allclose(rigid.from_quaternion([0, 0, 0], [-3 * q for q in xyzw]), expected, atol=COMPOSED)


@given(vectors, st.floats(0.0, 180.0))
@example((1.0, 0.0, 0.0), 180.0)
def test_the_angle_is_the_length_of_the_vector(direction, angle_deg):
    move = rigid.from_parts([1, 2, 3], unit(direction) * angle_deg)
    assert abs(rigid.rotation_angle_deg(move) - angle_deg) < 1e-6


def test_a_quarter_turn_about_z_takes_x_to_y():
    np.testing.assert_allclose(rigid.apply(rigid.rotation([0, 0, np.pi / 2]), [1, 0, 0]), [0, 1, 0], atol=COMPOSED)


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        (np.eye(3), "4x4"),
        (np.full((4, 4), np.nan), "finite"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "mirrors"),
        (np.diag([1.1, 1.1, 1.1, 1.0]), "scale"),
        (np.diag([1.0, 1.0, 1.0, 2.0]), "last row"),
    ],
)
def test_what_is_not_a_rigid_transform_is_refused(matrix, words):
    with pytest.raises(CalibrationError, match=words):
        rigid.validate_rigid(matrix, "the alignment")


def test_a_transform_read_from_float32_is_made_orthonormal_again():
    move = rigid.from_parts([10, 20, 30], [40, -50, 60])
    mended = rigid.validate_rigid(move.astype(np.float32), "the alignment")
    np.testing.assert_allclose(mended[:3, :3].T @ mended[:3, :3], np.eye(3), atol=COMPOSED)
    np.testing.assert_allclose(mended, move, atol=1e-5)


def test_a_quaternion_without_length_is_refused():
    with pytest.raises(CalibrationError, match="length"):
        rigid.from_quaternion([0, 0, 0], [0, 0, 0, 0])


@pytest.mark.parametrize("length", [5e-324, 1e-300, 1e-160, 1e160, 1e308])
def test_a_quaternion_of_any_length_counts_by_its_direction(length):
    turned = rigid.from_quaternion([0, 0, 0], [0.0, 0.0, length, length])
    np.testing.assert_allclose(turned, rigid.rotation([0.0, 0.0, np.pi / 2]), atol=COMPOSED)
