from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.errors import CalibrationError
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.sensors.alignment import Alignment
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.target_depth.surface_projection import project_cloud
from tests.pipeline.stages.test_back_projection import by, depth_map
from tests.pipeline.stages.test_target_depth import (
    CENTRE_MM,
    PAPER,
    SOURCE,
    SURFACE,
    sphere_depth_mm,
    target_sensor,
)

# two interpolations between pixels of 0.045 mm on a sphere of 15 mm: 2e-5 each, and float32
ROUND_TRIP_MM = 2e-4
FLOAT32_ULP = 2.0**-23  # relative
DEPTH = sphere_depth_mm(SOURCE)
TOUCH = depth_map(DEPTH, DEPTH < 41.0, SOURCE)


def reproject(depth, alignment, target, params, *, stride=1):
    return project_cloud(
        back_project_depth(depth, alignment, BackProjectionParams(stride=stride)), target, params
    )


def turned(angle_deg):
    return by(
        rigid.translation(*CENTRE_MM)
        @ rigid.rotation([0.0, np.deg2rad(angle_deg), 0.0])
        @ rigid.translation(*-CENTRE_MM)
    )


def by_the_equations(touch, target_from_source, camera, stride):
    """The paper's D_T'' (rows, cols), NaN where no point falls: every contact pixel
    back-projected, moved, projected.
    """
    source = touch.camera
    taken = np.zeros(touch.contact.shape, bool)
    taken[::stride, ::stride] = touch.contact[::stride, ::stride]
    row, col = np.nonzero(taken)
    z = touch.depth_mm[taken].astype(np.float64)
    rays = np.stack(
        [(col - source.cx_px) / source.fx_px, (row - source.cy_px) / source.fy_px, np.ones(len(z))]
    )
    moved = target_from_source[:3, :3] @ (z * rays) + target_from_source[:3, 3:]
    x = camera.fx_px * moved[0] / moved[2] + camera.cx_px
    y = camera.fy_px * moved[1] / moved[2] + camera.cy_px
    x_px = np.floor(x + 0.5).astype(int)
    y_px = np.floor(y + 0.5).astype(int)
    inside = (x_px >= 0) & (x_px < camera.cols) & (y_px >= 0) & (y_px < camera.rows)
    nearest = np.full(camera.shape, np.inf)
    np.minimum.at(nearest, (y_px[inside], x_px[inside]), moved[2, inside])
    return np.where(np.isinf(nearest), np.nan, nearest)


@pytest.mark.parametrize("stride", [1, 4])
@pytest.mark.parametrize("angle_deg", [0.0, 20.0, -50.0])
def test_the_papers_way_in_one_go_is_the_papers_equations(stride, angle_deg):
    alignment = turned(angle_deg)
    target = target_sensor()
    view = reproject(TOUCH, alignment, target, PAPER, stride=stride)
    wanted_mm = by_the_equations(TOUCH, alignment.target_from_source, target.camera, stride)
    n_points = np.isfinite(wanted_mm).sum()
    assert n_points > 300 / stride**2
    # Points are rounded to float32 on the way: those on the border of two pixels may fall on
    # either.
    off = np.isfinite(view.depth_mm) ^ np.isfinite(wanted_mm)
    off |= np.abs(view.depth_mm - wanted_mm) > 4 * FLOAT32_ULP * 41.0
    assert off.sum() <= 0.002 * n_points + 1


# squares of the pitch: 16 times
@pytest.mark.parametrize(("stride", "sag_mm"), [(1, 5e-4), (4, 8e-3)])
def test_the_surface_in_one_go_is_the_sphere_that_was_felt(stride, sag_mm):
    target = target_sensor()
    view = reproject(TOUCH, turned(20.0), target, SURFACE, stride=stride)
    seen = view.source_index >= 0
    assert seen.sum() > 1000
    assert view.pixel_of_point.size == np.count_nonzero(TOUCH.contact[::stride, ::stride])
    assert np.abs(view.depth_mm - sphere_depth_mm(target.camera))[seen].max() < sag_mm


def test_a_preview_is_the_same_picture_smaller():
    target = target_sensor(rows=72, cols=92)
    small = target.with_camera(target.camera.scale(0.25))
    assert small.camera.shape == (18, 23)
    assert target.with_camera(target.camera.scale(0.25)) is small
    view = reproject(TOUCH, turned(20.0), small, SURFACE, stride=2)
    seen = np.isfinite(view.depth_mm)
    assert seen.sum() > 30
    # sag of twice the pitch, sideways
    assert np.abs(view.depth_mm - sphere_depth_mm(small.camera))[seen].max() < 3e-3


def test_there_and_back_again_is_where_it_was():
    fine = Camera(rows=180, cols=240, fx_px=900.0, fy_px=900.0, cx_px=119.5, cy_px=89.5)
    there = turned(10.0)
    depth = sphere_depth_mm(fine)
    target = target_sensor(rows=240, cols=320, fx_px=900.0)
    view = reproject(depth_map(depth, depth < 40.5, fine), there, target, SURFACE)
    seen = depth_map(view.depth_mm, np.isfinite(view.depth_mm), target.camera)
    back = replace(target, camera=fine, rest_depth_mm=np.full(fine.shape, 45.0))
    returned = reproject(seen, by(rigid.invert(there.target_from_source)), back, SURFACE)
    both = np.isfinite(returned.depth_mm) & (depth < 40.5)
    assert both.sum() > 0.9 * (depth < 40.5).sum()
    assert np.abs(returned.depth_mm - depth)[both].max() < ROUND_TRIP_MM


@settings(max_examples=15)
@given(
    st.lists(st.floats(-180, 180), min_size=3, max_size=3),
    st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
    st.floats(0.0, 6.0),
)
def test_moving_the_shared_frame_moves_nothing(rotation_deg, direction, exponent):
    """T_A->T o G^-1 o G o T_S->A: what float64 loses to a shift of d mm is a few of its ulps at
    d.
    """
    shift_mm = np.array(direction) * 10.0**exponent
    move = rigid.from_parts(shift_mm, rotation_deg)
    plain = turned(20.0)
    target = target_sensor()
    moved = Alignment(
        alignment_from_source=move @ plain.alignment_from_source,
        target_from_alignment=plain.target_from_alignment @ rigid.invert(move),
    )
    one, two = (reproject(TOUCH, a, target, SURFACE) for a in (plain, moved))
    both = np.isfinite(one.depth_mm) & np.isfinite(two.depth_mm)
    lost_mm = 16 * 2.0**-52 * (np.abs(shift_mm).max() + 100.0)
    # Outermost pixels may come or go; inside, the loss of float64, and one rounding to float32 on
    # either side.
    assert (np.isfinite(one.depth_mm) ^ np.isfinite(two.depth_mm)).sum() <= 8
    assert np.abs(one.depth_mm - two.depth_mm)[both].max() <= 4 * lost_mm + 4 * FLOAT32_ULP * 41.0


def test_metres_for_millimetres_change_nothing_but_the_unit():
    """A thousandth of every length, with limits to match, is the same picture in another unit."""
    target = target_sensor()
    surface = replace(
        target.membrane,
        x0_mm=-0.03,
        y0_mm=-0.03,
        step_mm=target.membrane.step_mm * 1e-3,
        z_mm=target.membrane.z_mm * 1e-3,
    )
    metres = replace(target, membrane=surface, rest_depth_mm=target.rest_depth_mm * 1e-3)
    move = turned(20.0).target_from_source.copy()
    move[:3, 3] *= 1e-3
    small = reproject(
        depth_map(DEPTH * 1e-3, DEPTH < 41.0, SOURCE),
        by(move),
        metres,
        replace(SURFACE, jump_mm=1e-3),
    )
    large = reproject(TOUCH, turned(20.0), target, SURFACE)
    both = np.isfinite(small.depth_mm) & np.isfinite(large.depth_mm)
    assert (np.isfinite(small.depth_mm) ^ np.isfinite(large.depth_mm)).sum() <= 8
    np.testing.assert_allclose(small.depth_mm[both] * 1e3, large.depth_mm[both], rtol=1e-6)


BAD = [np.nan, np.inf, -np.inf, 0.0, -3.0, 1e-40, 1e30, 3e38, 1e-3, 40.0]


@settings(max_examples=40)
@given(
    st.lists(st.sampled_from(BAD), min_size=36, max_size=36),
    st.sampled_from([1.0, 40.0, 1e5]),
    st.sampled_from([PAPER, SURFACE]),
    st.sampled_from([0.0, 90.0, 180.0]),
)
def test_whatever_the_depth_holds_the_view_is_sound(values, fx_px, params, angle_deg):
    camera = Camera(rows=6, cols=6, fx_px=fx_px, fy_px=fx_px, cx_px=2.5, cy_px=2.5)
    touch = depth_map(np.reshape(values, (6, 6)), np.ones((6, 6)), camera)
    view = reproject(
        touch,
        by(rigid.from_parts([0, 0, 5.0], [0, angle_deg, 0])),
        target_sensor(20, 20, fx_px),
        params,
    )
    seen = view.source_index >= 0
    np.testing.assert_array_equal(seen, np.isfinite(view.depth_mm))
    assert (view.depth_mm[seen] > 0).all()
    assert np.isfinite(view.indentation_mm).all()
    assert not (view.contact & ~seen).any()
    assert view.pixel_of_point.max(initial=-1) < 400


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1)])
@pytest.mark.parametrize("params", [PAPER, SURFACE])
def test_a_row_a_column_and_a_single_pixel_arrive_as_points(shape, params):
    camera = Camera(rows=shape[0], cols=shape[1], fx_px=40.0, fy_px=40.0, cx_px=0.0, cy_px=0.0)
    view = reproject(
        depth_map(np.full(shape, 40.0), np.ones(shape), camera),
        by(np.eye(4)),
        target_sensor(),
        params,
    )
    assert (view.source_index >= 0).sum() == shape[0] * shape[1]


def test_an_alignment_that_is_not_rigid_is_refused():
    with pytest.raises(CalibrationError, match="finite"):
        reproject(TOUCH, by(np.full((4, 4), np.nan)), target_sensor(), SURFACE)
