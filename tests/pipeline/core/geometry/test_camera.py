from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.errors import CalibrationError
from pipeline.core.geometry.camera import Camera, make_camera

cameras = st.builds(
    Camera,
    rows=st.integers(1, 40),
    cols=st.integers(1, 40),
    fx_px=st.floats(1.0, 1e5),
    fy_px=st.floats(1.0, 1e5),
    cx_px=st.floats(-50.0, 50.0),
    cy_px=st.floats(-50.0, 50.0),
)


@given(cameras, st.floats(1e-2, 1e6))
def test_projecting_a_back_projected_pixel_returns_the_pixel(camera, depth_mm):
    points = camera.back_project(np.full(camera.shape, depth_mm))
    x_px, y_px, visible = camera.project(points)
    rows, cols = np.mgrid[: camera.rows, : camera.cols]
    np.testing.assert_allclose(x_px, cols, atol=1e-9)
    np.testing.assert_allclose(y_px, rows, atol=1e-9)
    assert visible.all()


@given(cameras)
def test_back_projection_is_the_inverse_of_k(camera):
    points = camera.back_project(np.full(camera.shape, 7.0)).reshape(-1, 3)
    rows, cols = np.mgrid[: camera.rows, : camera.cols].reshape(2, -1)
    expected = (
        7.0
        * np.linalg.solve(camera.matrix, np.stack([cols, rows, np.ones_like(rows)]).astype(float)).T
    )
    np.testing.assert_allclose(points, expected, rtol=1e-9, atol=1e-9)


def test_what_lies_behind_or_aside_or_is_not_a_number_is_not_visible():
    camera = Camera(rows=4, cols=6, fx_px=10, fy_px=10, cx_px=2.5, cy_px=1.5)
    points = [
        [0, 0, 5],
        [0, 0, -5],
        [0, 0, 0],
        [50, 0, 5],
        [np.nan, 0, 5],
        [0, 0, np.nan],
        [np.inf, 0, 5],
    ]
    assert camera.project(points)[2].tolist() == [True, False, False, False, False, False, False]


@given(st.integers(1, 60), st.integers(1, 60), st.floats(0.2, 4.0))
def test_scaling_keeps_the_field_of_view(rows, cols, factor):
    camera = Camera(rows=rows, cols=cols, fx_px=50.0, fy_px=60.0, cx_px=cols / 3, cy_px=rows / 3)
    other = camera.scale(factor)
    for a, b, n, m in (
        (camera.cx_px, other.cx_px, camera.cols, other.cols),
        (camera.cy_px, other.cy_px, camera.rows, other.rows),
    ):
        f, g = (
            (camera.fx_px, other.fx_px)
            if a == camera.cx_px and n == camera.cols
            else (camera.fy_px, other.fy_px)
        )
        if n == camera.rows and a == camera.cy_px:
            f = camera.fy_px
            g = other.fy_px
        np.testing.assert_allclose((-0.5 - a) / f, (-0.5 - b) / g, atol=1e-12)
        np.testing.assert_allclose((n - 0.5 - a) / f, (m - 0.5 - b) / g, atol=1e-12)


def test_a_crop_sees_the_same_points():
    camera = Camera(rows=20, cols=30, fx_px=40, fy_px=40, cx_px=14.5, cy_px=9.5)
    points = camera.back_project(np.full(camera.shape, 9.0))
    np.testing.assert_array_equal(
        camera.crop(3, 5, 8, 10).back_project(np.full((8, 10), 9.0)), points[3:11, 5:15]
    )


def test_k_makes_the_camera_it_came_from():
    camera = Camera(rows=20, cols=30, fx_px=41, fy_px=42, cx_px=14.5, cy_px=9.5)
    assert make_camera(2.0 * camera.matrix, 20, 30) == camera


@pytest.mark.parametrize(
    ("k", "words"),
    [
        (np.zeros((3, 3)), "singular"),
        (np.eye(2), "3x3"),
        (np.full((3, 3), np.inf), "finite"),
        ([[10, 1, 0], [0, 10, 0], [0, 0, 1]], "skew"),
        ([[10, 0, 0], [0, 10, 0], [1, 0, 1]], "triangular"),
        ([[-10, 0, 0], [0, 10, 0], [0, 0, 1]], "singular"),
    ],
)
def test_a_k_without_inverse_is_refused(k, words):
    with pytest.raises(CalibrationError, match=words):
        make_camera(k, 20, 30)


@pytest.mark.parametrize(
    ("fx", "fy", "cx", "cy"),
    [
        (1e-3, 1e-3, 1e9, 65.0),
        (2.9, 40, 15, 10),
        (40, 2e5, 15, 10),
        (40, 40, 200, 10),
        (40, 40, 15, -90),
    ],
)
def test_a_k_that_no_camera_of_such_an_image_has_is_refused(fx, fy, cx, cy):
    """What is computed of it, such as a cloud's extent in pixels, would take petabytes."""
    with pytest.raises(CalibrationError, match="cannot be that of an image of 30 x 20 px"):
        make_camera([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], 20, 30)


def test_an_image_without_pixels_is_refused():
    with pytest.raises(CalibrationError, match="pixel"):
        Camera(rows=0, cols=30, fx_px=1, fy_px=1, cx_px=0, cy_px=0)


@pytest.mark.parametrize(
    "wrong", [{"fx_px": 1e-40}, {"fy_px": 1e-5}, {"fx_px": 3e38}, {"cx_px": -3e38}, {"cy_px": 1e12}]
)
def test_intrinsics_of_no_camera_are_refused(wrong):
    numbers = {"fx_px": 100.0, "fy_px": 100.0, "cx_px": 15.5, "cy_px": 11.5}
    with pytest.raises(CalibrationError, match="cannot be right"):
        Camera(rows=24, cols=32, **{**numbers, **wrong})
