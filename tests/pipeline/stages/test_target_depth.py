from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import ndimage

from pipeline.core.errors import ShapeError
from pipeline.core.geometry import membrane, rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.values.results import Cloud
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import load_sensor
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.target_depth import surface_projection
from pipeline.stages.target_depth.surface_projection import (
    PointSplatParams,
    SurfaceProjectionParams,
    project_cloud,
    skip_without_contact,
)
from tests.pipeline.stages.test_back_projection import depth_map

PAPER = PointSplatParams()
SURFACE = SurfaceProjectionParams()
SOURCE = Camera(rows=120, cols=160, fx_px=400.0, fy_px=400.0, cx_px=79.5, cy_px=59.5)
CENTRE_MM = np.array([0.0, 0.0, 55.0])
RADIUS_MM = 15.0
# a chord of one source diagonal, d^2 / 8 R, seen at up to 65 degrees; and float32 at 50 mm
SAG_MM = 6e-4
# half a step beyond two points a chord apart: 3/8 of f'' h^2 where a chord has 1/8
RIM_SAG_MM = 3 * SAG_MM


def target_sensor(rows=70, cols=90, fx_px=200.0, rest_mm=45.0):
    camera = Camera(
        rows=rows, cols=cols, fx_px=fx_px, fy_px=fx_px, cx_px=(cols - 1) / 2, cy_px=(rows - 1) / 2
    )
    pad = membrane.make_flat_membrane(rest_mm, 30.0, 30.0)
    return replace(
        load_sensor("gelslim"), camera=camera, membrane=pad, rest_depth_mm=pad.rest_depth_mm(camera)
    )


def sphere_depth_mm(camera):
    x, y = camera.rays()
    ray = np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.ones(camera.shape)], axis=-1)
    a = (ray**2).sum(-1)
    b = ray @ CENTRE_MM
    root = b**2 - a * (CENTRE_MM @ CENTRE_MM - RADIUS_MM**2)
    return np.where(root >= 0, (b - np.sqrt(np.maximum(root, 0.0))) / a, np.nan)


def sphere_cloud(angle_deg=0.0, stride=1):
    turn = (
        rigid.translation(*CENTRE_MM)
        @ rigid.rotation([0.0, np.deg2rad(angle_deg), 0.0])
        @ rigid.translation(*-CENTRE_MM)
    )
    depth = sphere_depth_mm(SOURCE)
    alignment = Alignment(alignment_from_source=turn, target_from_alignment=np.eye(4))
    return back_project_depth(
        depth_map(depth, depth < 41.0, SOURCE), alignment, BackProjectionParams(stride=stride)
    )


def cloud_of(points, index=None, grid=(50, 50)):
    points = np.asarray(points, np.float32).reshape(-1, 3)
    index = np.arange(len(points)) if index is None else index
    return Cloud(
        field_of_view_mm=np.array([[-9, -9, 20], [9, -9, 20], [9, 9, 20], [-9, 9, 20]], np.float32),
        points_mm=points,
        source_index=np.asarray(index, np.int32),
        grid_shape=grid,
    )


@pytest.mark.parametrize("angle_deg", [0.0, 20.0, 45.0])
@pytest.mark.parametrize("scale", [1, 3])
def test_the_surface_of_a_sphere_has_no_holes_and_lies_on_the_sphere(angle_deg, scale):
    target = target_sensor(rows=70 * scale, cols=90 * scale, fx_px=200.0 * scale)
    view = project_cloud(sphere_cloud(angle_deg), target, SURFACE)
    seen = np.isfinite(view.depth_mm)
    assert seen.sum() > 500 * scale**2
    assert (ndimage.binary_fill_holes(seen) == seen).all()
    off_mm = np.abs(view.depth_mm - sphere_depth_mm(target.camera))
    assert off_mm[seen].max() < RIM_SAG_MM
    inside = ndimage.binary_erosion(seen, iterations=2 * scale)
    assert off_mm[inside].max() < SAG_MM


@pytest.mark.parametrize("hole", [False, True])
def test_a_mask_extends_half_a_source_pixel_beyond_its_outermost_points(hole):
    """20 x 30 source pixels of 0.5 mm, 2.5 target pixels each at 40 mm, are drawn at their full
    size.
    """
    rows, cols = np.mgrid[:20, :30]
    sheet = np.stack([(cols - 14.5) * 0.5, (rows - 9.5) * 0.5, 40.0 + 0.05 * cols], -1)
    there = ~((rows == 10) & (cols == 15)) if hole else np.ones((20, 30), bool)
    target = target_sensor(rows=280, cols=360, fx_px=800.0)
    cloud = cloud_of(sheet[there], index=np.flatnonzero(there), grid=(20, 30))
    view = project_cloud(cloud, target, SURFACE)
    row, col = np.nonzero(np.isfinite(view.depth_mm))
    z_mm = target.camera.back_project(view.depth_mm)[row, col]
    plane_mm = 40.0 + 0.05 * (z_mm[:, 0] / 0.5 + 14.5)
    assert np.abs(z_mm[:, 2] - plane_mm).max() < 1e-5  # a plane goes on straight; float32 at 40 mm
    area_mm2 = (z_mm[:, 2] ** 2 / 800.0**2).sum()
    corners_mm2 = 4 * 0.5**2 / 8  # cut off where the mask turns
    hole_mm2 = 0.5**2 / 2 if hole else 0.0  # a lonely gap closes by half
    slant = 1.0 - 0.1 * z_mm[:, 0].mean() / z_mm[:, 2].mean()
    # a tenth of a target pixel all round
    assert abs(area_mm2 / slant - (15.0 * 10.0 - corners_mm2 - hole_mm2)) < 0.5


def test_noise_close_to_the_lens_has_limited_cost():
    """Depths of micrometres: each triangle would cover the image, 19,000 times.

    At most LAYERS of them are drawn.
    """
    rng = np.random.default_rng(0)
    z, x, y = rng.uniform(2e-3, 6e-3, 10_000), *rng.uniform(-0.2, 0.2, (2, 10_000))
    noise = cloud_of(np.stack([x * z, y * z, z], -1), grid=(100, 100))
    target = target_sensor(rows=280, cols=360, fx_px=800.0)
    view = project_cloud(noise, target, replace(SURFACE, grazing_deg=90.0))
    np.testing.assert_array_equal(view.source_index >= 0, np.isfinite(view.depth_mm))
    assert any("overlaps itself" in note for note in view.notes)
    assert not any(
        "overlaps itself" in note for note in project_cloud(sphere_cloud(), target, SURFACE).notes
    )


def test_the_point_splat_has_hundreds_of_times_the_error_of_the_surface():
    target = target_sensor()
    cloud = sphere_cloud(20.0)
    exact = sphere_depth_mm(target.camera)
    paper, surface = (
        np.nanmean(np.abs(project_cloud(cloud, target, p).depth_mm - exact))
        for p in (PAPER, SURFACE)
    )
    assert paper > 100 * surface  # 1000 at the resolution of benchmarks/reprojection.py


points = st.lists(
    st.tuples(
        *[st.floats(-12, 12, width=32)] * 2, st.sampled_from([-5.0, 0.0, 30.0, 44.0, 45.0, 50.0])
    ),
    min_size=1,
    max_size=60,
)


@settings(max_examples=60)
@given(points, st.randoms(use_true_random=False))
def test_the_nearest_point_wins_each_pixel_in_any_order(raw, random):
    target = target_sensor()
    cloud = cloud_of(raw)
    view = project_cloud(cloud, target, PAPER)
    x_px, y_px, visible = target.camera.project(cloud.points_mm)
    expected = np.full(target.camera.shape, np.inf, np.float32)
    for k in np.flatnonzero(visible):
        at = int(np.floor(y_px[k] + 0.5)), int(np.floor(x_px[k] + 0.5))
        expected[at] = min(expected[at], cloud.points_mm[k, 2])
    np.testing.assert_array_equal(view.depth_mm, np.where(np.isinf(expected), np.nan, expected))
    order = list(range(len(raw)))
    random.shuffle(order)
    again = project_cloud(cloud_of(cloud.points_mm[order], index=order), target, PAPER)
    assert again.depth_mm.tobytes() == view.depth_mm.tobytes()
    assert again.contact.tobytes() == view.contact.tobytes()
    won = view.source_index >= 0
    np.testing.assert_array_equal(np.array(order)[again.source_index[won]], view.source_index[won])


def test_pixels_are_half_open_squares():
    target = target_sensor(rows=1, cols=4, fx_px=1.0, rest_mm=45.0)
    camera = replace(target.camera, cx_px=0.0, cy_px=0.0)
    target = replace(target, camera=camera)
    for x_px, col in (
        (-0.5, 0),
        (np.nextafter(np.float32(0.5), np.float32(0.0)), 0),
        (0.5, 1),
        (2.5, 3),
    ):
        view = project_cloud(cloud_of([(x_px, 0.0, 1.0)]), target, PAPER)
        assert np.flatnonzero(view.source_index[0] >= 0).tolist() == [col]
    for x_px in (-0.5001, 3.5, 1e30):
        assert (project_cloud(cloud_of([(x_px, 0.0, 1.0)]), target, PAPER).source_index == -1).all()


def test_contact_is_where_the_surface_penetrates_the_membrane():
    target = target_sensor(rest_mm=40.5)
    view = project_cloud(sphere_cloud(), target, SURFACE)
    seen = np.isfinite(view.depth_mm)
    np.testing.assert_array_equal(view.contact, seen & (view.depth_mm <= 40.5))
    np.testing.assert_allclose(
        view.indentation_mm[view.contact], 40.5 - view.depth_mm[view.contact], atol=1e-5
    )
    assert (view.indentation_mm[~view.contact] == 0).all()
    assert 0 < view.contact.sum() < seen.sum()


def test_a_touch_short_of_the_membrane_names_the_gap():
    view = project_cloud(sphere_cloud(), target_sensor(rest_mm=39.7), SURFACE)
    assert not view.contact.any()
    assert any("0.3 mm before" in note for note in view.notes)


def test_a_touch_outside_the_image_has_a_reason():
    cloud = sphere_cloud()
    aside = replace(cloud, points_mm=cloud.points_mm + np.float32([500, 0, 0]))
    behind = replace(cloud, points_mm=-cloud.points_mm)
    for moved, word in ((aside, "outside"), (behind, "behind")):
        for params in (PAPER, SURFACE):
            view = project_cloud(moved, target_sensor(), params)
            assert not np.isfinite(view.depth_mm).any()
            assert word in view.notes[0]


def sheet_before_another(tilt_deg):
    """A sheet of 20 x 15 mm at 40 mm, turned about y, and a level one 22 mm behind its middle."""
    row, col = np.mgrid[:31, :41]
    along = (col - 20) * 0.5
    tilt = np.deg2rad(tilt_deg)
    front = np.stack([along * np.cos(tilt), (row - 15) * 0.5, 40.0 + along * np.sin(tilt)], -1)
    back = np.stack([(col - 20) * 0.8, (row - 15) * 0.8, np.full(row.shape, 62.0)], -1)
    return cloud_of(np.concatenate([front, back], axis=1), grid=(31, 82))


@settings(max_examples=60)
@given(st.floats(0.0, 89.0), st.floats(10.0, 90.0))
@example(80.0, 70.0)
@example(86.0, 84.0)
@example(60.0, 90.0)
@example(41.0, 30.0)
def test_an_omitted_grazing_surface_still_hides_what_is_behind(tilt_deg, grazing_deg):
    """What lies behind showed through: up to 21 mm off."""
    target = target_sensor()
    tilt = np.deg2rad(tilt_deg)
    view = project_cloud(
        sheet_before_another(tilt_deg), target, replace(SURFACE, grazing_deg=grazing_deg)
    )
    x, y = target.camera.rays()
    along = 40.0 * x / (np.cos(tilt) - x * np.sin(tilt))
    front_mm = 40.0 + along * np.sin(tilt)
    inside = (np.abs(along) < 9.9) & (np.abs(front_mm * y[:, None]) < 7.4)
    shown = inside & np.isfinite(view.depth_mm)
    assert np.abs(view.depth_mm - front_mm)[shown].max(initial=0.0) < 1e-4  # float32 at 50 mm
    kept = tilt_deg + np.rad2deg(np.arctan(np.hypot(x.max(), y.max()))) < grazing_deg - 1.0
    assert not kept or shown.sum() == inside.sum()
    level_share = np.isfinite(view.depth_mm[:, :2]).mean()  # the level sheet alone, and it is there
    reached = np.abs(along[:2]).min() < 10.3  # by the front and its rim
    left_out = tilt_deg + np.rad2deg(np.arctan(np.hypot(x.max(), y.max()))) > grazing_deg
    assert level_share == 1.0 or grazing_deg < 30.0 or (reached and left_out)


def test_pixels_hidden_by_an_omitted_surface_are_noted():
    for tilt_deg, said in ((86.0, True), (20.0, False)):
        notes = project_cloud(sheet_before_another(tilt_deg), target_sensor(), SURFACE).notes
        assert any("hide what lies behind them" in note for note in notes) == said


def test_a_depth_jump_is_not_bridged():
    rows, cols = np.mgrid[:20, :20]
    z = np.where(cols < 10, 40.0, 44.0)
    flat = cloud_of(np.stack([(cols - 9.5) * 0.5, (rows - 9.5) * 0.5, z], -1), grid=(20, 20))
    view = project_cloud(flat, target_sensor(), SURFACE)
    seen = view.depth_mm[np.isfinite(view.depth_mm)]
    assert set(np.round(seen, 3)) <= {40.0, 44.0}
    assert any("depth jumps" in note for note in view.notes)
    bridged = project_cloud(flat, target_sensor(), replace(SURFACE, jump_mm=10.0)).depth_mm
    assert ((bridged > 40.5) & (bridged < 43.5)).any()


def test_the_nearer_sheet_hides_the_farther_one():
    rows, cols = np.mgrid[:20, :40]
    near = cols < 20
    x = np.where(near, cols - 9.5, cols - 29.5) * 0.3
    sheet = np.stack([x, (rows - 9.5) * 0.3, np.where(near, 38.0, 44.0)], -1)
    view = project_cloud(cloud_of(sheet, grid=(20, 40)), target_sensor(), SURFACE)
    middle = view.depth_mm[25:45, 35:55]
    np.testing.assert_allclose(middle, 38.0, atol=1e-5)
    assert any("hidden behind" in note for note in view.notes)


def test_every_target_pixel_names_a_source_point_within_a_source_pixel():
    cloud = sphere_cloud(20.0)
    target = target_sensor()
    view = project_cloud(cloud, target, SURFACE)
    row, col = np.nonzero(view.source_index >= 0)
    x_px, y_px, _ = target.camera.project(cloud.points_mm[view.source_index[row, col]])
    assert np.hypot(x_px - col, y_px - row).max() < 1.0


def test_a_coarse_preview_stays_on_the_sphere():
    view = project_cloud(sphere_cloud(stride=4), target_sensor(), SURFACE)
    seen = np.isfinite(view.depth_mm)
    assert seen.sum() > 600
    # sag ~ pitch^2
    assert np.abs(view.depth_mm - sphere_depth_mm(target_sensor().camera))[seen].max() < 16 * SAG_MM


def test_isolated_points_and_tiny_touches_are_drawn():
    lonely = project_cloud(cloud_of([(0.0, 0.0, 44.0)]), target_sensor(), SURFACE)
    assert lonely.contact.sum() == 1
    tiny = [(0.06 + 0.01 * c, 0.06 + 0.01 * r, 44.0) for r in range(2) for c in range(2)]
    view = project_cloud(cloud_of(tiny, index=[0, 1, 50, 51]), target_sensor(), SURFACE)
    assert view.contact.sum() == 1
    assert any("smaller than a target pixel" in note for note in view.notes)


def test_an_empty_cloud_gives_the_exact_empty_view():
    target = target_sensor()
    view = skip_without_contact(cloud_of([]), target, SURFACE)
    assert view is not None
    assert view.depth_mm.shape == target.camera.shape
    assert not view.contact.any()
    assert (view.source_index == -1).all()
    assert skip_without_contact(sphere_cloud(), target, SURFACE) is None


def test_a_cloud_that_points_outside_its_grid_is_refused():
    with pytest.raises(ShapeError, match="outside its grid"):
        project_cloud(cloud_of([(0, 0, 40)], index=[2500]), target_sensor(), SURFACE)


def test_points_index_their_pixel_and_hidden_ones_none():
    rows, cols = np.mgrid[:20, :40]
    near = cols < 20
    x = np.where(near, cols - 9.5, cols - 29.5) * 0.3
    sheet = cloud_of(
        np.stack([x, (rows - 9.5) * 0.3, np.where(near, 38.0, 44.0)], -1), grid=(20, 40)
    )
    target = target_sensor()
    for params in (PAPER, SURFACE):
        view = project_cloud(sheet, target, params)
        assert view.pixel_of_point is not None
        shown = view.pixel_of_point >= 0
        assert shown[near.ravel()].all()
        x_px, y_px, _ = target.camera.project(sheet.points_mm)
        np.testing.assert_array_equal(
            view.pixel_of_point[shown], (np.rint(y_px) * target.camera.cols + np.rint(x_px))[shown]
        )
    hidden = ~near.ravel() & ~shown
    assert hidden.sum() > 200  # a far sheet is seen around the near one's rim only
    outside = replace(sheet, points_mm=sheet.points_mm + np.float32([500, 0, 0]))
    assert (project_cloud(outside, target, SURFACE).pixel_of_point == -1).all()


def test_the_index_maps_agree_both_ways():
    cloud = sphere_cloud(20.0)
    target = target_sensor()
    view = project_cloud(cloud, target, PAPER)
    shown = np.flatnonzero(view.source_index.ravel() >= 0)
    assert view.pixel_of_point is not None
    np.testing.assert_array_equal(view.pixel_of_point[view.source_index.ravel()[shown]], shown)
    surface = project_cloud(cloud, target, SURFACE).pixel_of_point
    # all but the points of the rim, which no triangle's pixel centre reaches
    assert (surface >= 0).mean() > 0.95


def test_the_field_of_view_may_be_rotated_or_larger_than_the_image():
    target = target_sensor()
    rows, cols = target.camera.shape
    for corners_px in (
        [(10, 5), (60, 15), (50, 55), (5, 45)],
        [(5, 45), (50, 55), (60, 15), (10, 5)],
        [(-1e6, -1e6), (1e6, -1e6), (1e6, 1e6), (-1e6, 1e6)],
    ):
        corners = np.array(corners_px, float)
        window = np.column_stack(
            [(corners[:, 0] - 44.5) / 200 * 40, (corners[:, 1] - 34.5) / 200 * 40, np.full(4, 40.0)]
        )
        known = project_cloud(
            replace(cloud_of([(0, 0, 44.0)]), field_of_view_mm=window.astype(np.float32)),
            target,
            SURFACE,
        ).in_view
        x, y = np.meshgrid(np.arange(cols), np.arange(rows))
        side = [
            (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
            for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)
        ]
        clear = np.min(np.abs(side), axis=0) > 1e-2  # float32 corners
        inside = np.all(np.array(side) > 0, axis=0) | np.all(np.array(side) < 0, axis=0)
        np.testing.assert_array_equal(known[clear], inside[clear])


@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)])
def test_a_level_field_of_view_ends_above_and_below_as_at_its_sides(order):
    x_px = np.array([2.2, 7.6, 7.6, 2.2])[order]
    y_px = np.array([1.5, 1.5, 5.2, 5.2])[order]
    with np.errstate(all="ignore"):  # as its caller does: a level edge has no column
        inside = surface_projection._rasterise_polygon(x_px, y_px, 8, 10)
    expected = np.zeros((8, 10), np.bool_)
    expected[2:6, 3:8] = True
    np.testing.assert_array_equal(inside, expected)
