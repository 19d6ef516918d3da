from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pipeline.core.errors import CalibrationError
from pipeline.core.geometry import rigid

COMPOSED = 1e-12  # a few roundings of float64 on rotations
number = st.floats(-1.0, 1.0)
vectors = st.tuples(number, number, number)


def unit(vector):
    length = np.linalg.norm(vector)
    return np.array([1.0, 0.0, 0.0]) if length < 1e-3 else np.asarray(vector) / length


@given(vectors, st.floats(0.0, np.pi))
def test_a_quaternion_says_the_same_as_a_rotation_vector(direction, length_rad):
    axis = unit(direction)
    xyzw = [*(axis * np.sin(length_rad / 2)), np.cos(length_rad / 2)]
    expected = rigid.rotation(axis * length_rad)
    np.testing.assert_allclose(rigid.from_quaternion([0, 0, 0], xyzw), expected, atol=COMPOSED)
    np.testing.assert_allclose(
        rigid.from_quaternion([0, 0, 0], [-3 * q for q in xyzw]), expected, atol=COMPOSED
    )


@given(vectors, st.floats(0.0, 180.0))
@example((1.0, 0.0, 0.0), 180.0)
def test_the_angle_is_the_length_of_the_vector(direction, angle_deg):
    move = rigid.from_parts([1, 2, 3], unit(direction) * angle_deg)
    assert abs(rigid.rotation_angle_deg(move) - angle_deg) < 1e-6


def test_a_quarter_turn_about_z_takes_x_to_y():
    np.testing.assert_allclose(
        rigid.apply(rigid.rotation([0, 0, np.pi / 2]), [1, 0, 0]), [0, 1, 0], atol=COMPOSED
    )


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
