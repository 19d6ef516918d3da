"""The paper's pose protocol: both fingers' points in the plane of the grasp."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import sample_surface
from pipeline.physics.simulation import shapes
from pipeline.stages.pose.registration.planar import (
    compute_first_euler_deg,
    compute_grasp_pose_error,
)

MESH = shapes.make_shape("three_lines").mesh
# the pattern lies in the grasp's plane
SIDEWAYS = np.array([[0.0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


def lay_in_plane():
    """The mesh with its pattern facing along x, as tools of the data set have it."""
    return type(MESH)(
        vertices_mm=rigid.apply(SIDEWAYS, MESH.vertices_mm), triangles=MESH.triangles, name="laid"
    )


def test_both_fingers_give_rotation_and_translation_in_the_plane():
    mesh = lay_in_plane()
    pose = rigid.from_parts((3.0, 1.5, -0.8), (8.0, 0.0, 0.0))
    points = rigid.apply(pose, sample_surface(mesh, 3000, 1)[0])
    right = points[points[:, 0] > 0]
    left = points[points[:, 0] <= 0]
    error = compute_grasp_pose_error(np.concatenate([right, left]), mesh, pose)
    assert error is not None
    assert error.rotation_deg < 0.5
    assert error.translation_mm < 0.15
    wrong = compute_grasp_pose_error(
        points, mesh, rigid.from_parts((0.0, 0.0, 0.0), (20.0, 0.0, 0.0))
    )
    assert wrong is not None
    assert wrong.rotation_deg == pytest.approx(12.0, abs=0.5)


def test_too_few_points_give_no_pose():
    assert compute_grasp_pose_error(np.zeros((3, 3)), lay_in_plane(), np.eye(4)) is None


@pytest.mark.parametrize("angle", [-170.0, -20.0, 0.0, 35.0])
def test_the_first_euler_angle_is_that_about_x(angle):
    rotation = rigid.from_parts((0.0, 0.0, 0.0), (angle, 0.0, 0.0))
    tilted = rotation @ rigid.from_parts((0.0, 0.0, 0.0), (0.0, 0.0, 30.0))
    assert compute_first_euler_deg(tilted) == pytest.approx(angle)
