from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.errors import CalibrationError, ShapeError
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.values.results import DepthMap
from pipeline.sensors.alignment import Alignment
from pipeline.stages.cloud.back_projection import (
    BackProjectionParams,
    back_project_depth,
    skip_without_contact,
)

CAMERA = Camera(rows=24, cols=32, fx_px=40.0, fy_px=42.0, cx_px=15.2, cy_px=11.7)
FLOAT32_ULP = 2.0**-23  # relative; a float32 is at most half of it off the exact value


def depth_map(depth_mm, contact, camera=CAMERA):
    depth_mm = np.asarray(depth_mm, np.float32)
    return DepthMap(
        indentation_mm=np.zeros_like(depth_mm),
        depth_mm=depth_mm,
        contact=np.asarray(contact, bool),
        camera=camera,
        source_index=np.arange(depth_mm.size, dtype=np.int32).reshape(depth_mm.shape),
    )


def by(target_from_source):
    return Alignment(alignment_from_source=target_from_source, target_from_alignment=np.eye(4))


def random_depth(seed=0):
    rng = np.random.default_rng(seed)
    return depth_map(rng.uniform(15, 25, CAMERA.shape), rng.random(CAMERA.shape) < 0.4)


@settings(max_examples=30)
@given(
    st.lists(st.floats(-180, 180), min_size=3, max_size=3),
    st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3),
)
def test_points_are_the_equation_rounded_once(rotation_deg, shift_mm):
    depth = random_depth()
    move = rigid.from_parts(shift_mm, rotation_deg)
    cloud = back_project_depth(depth, by(move), BackProjectionParams())
    row, col = np.nonzero(depth.contact)
    homogeneous = np.stack([col, row, np.ones_like(row)]).astype(float)
    z = depth.depth_mm[row, col].astype(float)
    exact = rigid.apply(move, (z * (np.linalg.inv(CAMERA.matrix) @ homogeneous)).T)
    # 1e-9: what is left of float64 in coordinates up to 1e6 mm that cancel
    assert (np.abs(cloud.points_mm - exact) <= 0.5 * FLOAT32_ULP * np.abs(exact) + 1e-9).all()


def test_source_index_names_the_contact_pixels_in_order():
    depth = random_depth()
    cloud = back_project_depth(depth, by(np.eye(4)), BackProjectionParams())
    np.testing.assert_array_equal(cloud.source_index, np.flatnonzero(depth.contact))
    assert cloud.grid_shape == CAMERA.shape
    assert cloud.points_mm.dtype == np.float32
    assert cloud.source_index.dtype == np.int32
    assert not cloud.points_mm.flags.writeable


def test_contact_without_depth_is_left_out_with_a_note():
    depth_mm = np.full(CAMERA.shape, 20.0)
    depth_mm[0, :5] = (np.nan, np.inf, 0.0, -3.0, 1e-30)
    cloud = back_project_depth(
        depth_map(depth_mm, np.ones(CAMERA.shape)), by(np.eye(4)), BackProjectionParams()
    )
    assert np.isfinite(cloud.points_mm).all()
    assert cloud.source_index[0] == 5
    assert cloud.notes == ("5 of 768 contact pixels have no depth and were left out",)


def test_a_preview_keeps_every_nth_row_and_column():
    cloud = back_project_depth(
        depth_map(np.full(CAMERA.shape, 20.0), np.ones(CAMERA.shape)),
        by(np.eye(4)),
        BackProjectionParams(stride=4),
    )
    row, col = np.divmod(cloud.source_index, CAMERA.cols)
    assert len(row) == 6 * 8
    assert (row % 4 == 0).all()
    assert (col % 4 == 0).all()
    assert cloud.stride == 4


def test_no_contact_gives_the_same_cloud_as_an_empty_mask():
    nothing = depth_map(np.full(CAMERA.shape, 20.0), np.zeros(CAMERA.shape))
    short = skip_without_contact(nothing, by(np.eye(4)), BackProjectionParams())
    long = back_project_depth(nothing, by(np.eye(4)), BackProjectionParams())
    assert short is not None
    assert short.points_mm.shape == long.points_mm.shape == (0, 3)
    assert short.notes == long.notes
    assert skip_without_contact(random_depth(), by(np.eye(4)), BackProjectionParams()) is None


def test_a_transform_that_is_not_rigid_and_arrays_that_do_not_fit_are_refused():
    with pytest.raises(CalibrationError, match="scale or shear"):
        back_project_depth(
            random_depth(), by(np.diag([2.0, 2.0, 2.0, 1.0])), BackProjectionParams()
        )
    with pytest.raises(ShapeError, match="shape"):
        back_project_depth(
            depth_map(np.zeros((3, 3)), np.zeros((3, 3))), by(np.eye(4)), BackProjectionParams()
        )


def test_an_object_surface_replaces_the_membrane_in_the_cloud():
    depth = depth_map(np.full(CAMERA.shape, 20.0), np.zeros(CAMERA.shape))
    contact = depth.contact.copy()
    object_depth = np.full(CAMERA.shape, np.nan, np.float32)
    contact[10, 10] = True
    object_depth[10, 10] = 21.0
    object_depth[10, 11] = 22.0
    cloud = back_project_depth(
        replace(depth, contact=contact, object_depth_mm=object_depth),
        by(np.eye(4)),
        BackProjectionParams(),
    )
    assert cloud.source_index.tolist() == [10 * CAMERA.cols + 10, 10 * CAMERA.cols + 11]
    assert cloud.points_mm[:, 2].tolist() == [21.0, 22.0]


def test_the_field_of_view_ends_half_a_pixel_beyond_the_outermost_centres():
    depth = depth_map(np.full(CAMERA.shape, 20.0), np.ones(CAMERA.shape))
    window = back_project_depth(
        depth, by(rigid.translation(1.0, 2.0, 3.0)), BackProjectionParams()
    ).field_of_view_mm
    columns = np.array([-0.5, 31.5, 31.5, -0.5])
    rows = np.array([-0.5, -0.5, 23.5, 23.5])
    expected = np.stack(
        [20.0 * (columns - 15.2) / 40.0, 20.0 * (rows - 11.7) / 42.0, np.full(4, 20.0)], axis=1
    )
    np.testing.assert_allclose(window, expected + np.array([1.0, 2.0, 3.0]), atol=1e-5)
