from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.normals import compute_area_vectors

CAMERA = Camera(rows=12, cols=16, fx_px=90.0, fy_px=80.0, cx_px=7.0, cy_px=6.0)
TILTS = st.floats(-1.2, 1.2)


def plane_mm(slope_x, slope_y):
    """z (rows, cols) of z = 40 + slope_x x + slope_y y along the camera's rays."""
    x, y = CAMERA.rays()
    return 40.0 / (1.0 - slope_x * x[None, :] - slope_y * y[:, None])


@given(TILTS, TILTS, st.integers(0, 2**32 - 1))
def test_a_plane_has_one_normal_whatever_is_missing_of_it(slope_x, slope_y, seed):
    depth = plane_mm(slope_x, slope_y)
    depth[np.random.default_rng(seed).random(depth.shape) < 0.3] = np.nan
    vectors = compute_area_vectors(CAMERA.back_project(depth))
    known = np.isfinite(vectors[..., 2])
    toward_camera = np.array([slope_x, slope_y, -1.0]) / np.hypot(np.hypot(slope_x, slope_y), 1.0)
    unit = vectors[known] / np.linalg.norm(vectors[known], axis=1, keepdims=True)
    np.testing.assert_allclose(unit, np.broadcast_to(toward_camera, unit.shape), atol=1e-9)
    assert known.sum() > 0.2 * known.size


def test_the_vectors_are_as_long_as_their_pixels_are_wide():
    vectors = compute_area_vectors(CAMERA.back_project(np.full(CAMERA.shape, 45.0)))
    area_mm2 = 45.0**2 / (CAMERA.fx_px * CAMERA.fy_px)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=-1), area_mm2, rtol=1e-9)


@pytest.mark.parametrize("shape", [(1, 5), (5, 1), (1, 1)])
def test_a_row_or_a_pixel_alone_faces_nowhere(shape):
    assert np.isnan(compute_area_vectors(np.ones((*shape, 3)))).all()
