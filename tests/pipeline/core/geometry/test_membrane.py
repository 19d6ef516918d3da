from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.scenes.rest_mesh import rest_mesh
from pipeline.core.geometry import membrane
from pipeline.core.geometry.camera import Camera

CAMERA = Camera(rows=35, cols=44, fx_px=46.0, fy_px=46.0, cx_px=21.5, cy_px=17.0)
DOME = membrane.make_dome_membrane(60.0, 20.0, 60.0, 50.0)
# 0.5 mm cells on a curvature of 2 * 20 / 50^2 per mm: h^2 / 8 * curvature, both ways
BILINEAR_MM = 1e-3


def dome_mm(x, y):
    return 60.0 + 20.0 * np.maximum(1 - (x / 60.0) ** 2 - (y / 50.0) ** 2, 0.0)


@given(st.floats(-40, 40), st.floats(-30, 30))
def test_a_dome_follows_its_formula(x_mm, y_mm):
    assert abs(DOME.depth_at(x_mm, y_mm) - dome_mm(x_mm, y_mm)) < BILINEAR_MM


@given(st.floats(-30, 30), st.floats(-25, 25), st.floats(-3, 3))
def test_the_sign_says_which_side_a_point_is_on(x_mm, y_mm, above_mm):
    height = float(DOME.depth_at(x_mm, y_mm))
    distance = float(DOME.signed_distance_mm([x_mm, y_mm, height + above_mm]))
    assert np.sign(distance) == np.sign(height + above_mm - height)
    assert abs(distance) <= abs(above_mm) + 1e-12, "the way along z is never the shortest"


def test_distance_near_the_surface_is_that_of_a_sphere_to_first_order():
    pad = membrane.make_flat_membrane(20.0, 10.0, 8.0)
    np.testing.assert_allclose(
        pad.signed_distance_mm([[0, 0, 19.5], [3, 4, 20.25], [99, 0, 20.0]]), [-0.5, 0.25, 0.0]
    )
    rays = np.random.default_rng(0).uniform(-20, 20, (200, 2))
    step = 0.05
    surface = np.column_stack([rays, dome_mm(*rays.T)])
    slope = np.column_stack([-40 * rays[:, 0] / 60**2, -40 * rays[:, 1] / 50**2])
    normal = np.column_stack([-slope, np.ones(200)]) / np.sqrt(1 + (slope**2).sum(1))[:, None]
    np.testing.assert_allclose(
        DOME.signed_distance_mm(surface - step * normal), -step, atol=2 * BILINEAR_MM
    )


@settings(max_examples=20)
@given(st.floats(5.0, 40.0), st.floats(40.0, 90.0))
def test_rest_depth_lies_on_the_surface_and_on_the_ray(height_mm, rim_mm):
    surface = membrane.make_dome_membrane(rim_mm, height_mm, 60.0, 50.0)
    points = CAMERA.back_project(surface.rest_depth_mm(CAMERA))
    np.testing.assert_allclose(
        surface.depth_at(points[..., 0], points[..., 1]), points[..., 2], atol=1e-6
    )


def test_a_flat_pad_rests_at_one_depth():
    np.testing.assert_allclose(
        membrane.make_flat_membrane(20.0, 10.0, 8.0).rest_depth_mm(CAMERA), 20.0, atol=1e-9
    )


def test_the_mesh_has_the_vertices_of_the_lattice_and_looks_one_way():
    mesh = rest_mesh(membrane.make_flat_membrane(20.0, 4.0, 2.0))
    a, b, c = (mesh.vertices_mm[mesh.triangles[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    assert (across[:, 2] > 0).all()
    low = mesh.vertices_mm.min(axis=0)
    high = mesh.vertices_mm.max(axis=0)
    np.testing.assert_allclose(across[:, 2].sum() / 2, np.prod((high - low)[:2]), rtol=1e-12)


def test_a_point_that_is_not_a_number_has_no_distance():
    assert np.isnan(DOME.signed_distance_mm([np.nan, 0.0, 70.0]))


def test_single_precision_points_are_measured_as_the_doubles_that_they_are():
    points = np.random.default_rng(4).uniform(-80, 80, (4000, 3)).astype(np.float32)
    np.testing.assert_array_equal(
        DOME.signed_distance_mm(points), DOME.signed_distance_mm(points.astype(np.float64))
    )
