from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.arrays import freeze
from pipeline.core.geometry import rigid
from pipeline.core.values.results import DepthMap, make_pixel_index
from pipeline.sensors.alignment import AXES, resolve_alignment, shift_alignment_along_z
from pipeline.sensors.spec import load_sensor
from pipeline.translation.alignment.nudge import axis_unit, compute_pivot_mm, nudge

EXACT = 1e-9  # mm: rounding of float64 at a hundred millimetres, with room
GEL = load_sensor("gelslim")
BUBBLE = load_sensor("soft_bubble")
ALIGNED = resolve_alignment(GEL, BUBBLE)


def touched(rows=slice(40, 60), cols=slice(300, 340)):
    contact = np.zeros(GEL.camera.shape, np.bool_)
    contact[rows, cols] = True
    depth = GEL.rest_depth_mm.astype(np.float32)
    return DepthMap(
        indentation_mm=freeze(np.zeros(GEL.camera.shape, np.float32)),
        depth_mm=freeze(depth),
        contact=freeze(contact),
        camera=GEL.camera,
        source_index=make_pixel_index(GEL.camera.shape),
    )


@given(st.sampled_from(AXES), st.floats(-5.0, 5.0))
def test_an_edit_is_undone_by_its_opposite_and_moves_the_pivot_by_its_shift_alone(axis, amount):
    pivot = compute_pivot_mm(touched(), ALIGNED)
    moved = nudge(ALIGNED, axis, amount, pivot_mm=pivot)
    in_source = rigid.apply(rigid.invert(ALIGNED.target_from_source), pivot)
    shift = rigid.apply(moved.target_from_source, in_source) - pivot
    assert np.linalg.norm(shift) == pytest.approx(
        abs(amount) if axis_unit(axis) == "mm" else 0.0, abs=EXACT
    )
    turn = moved.target_from_source @ rigid.invert(ALIGNED.target_from_source)
    assert rigid.rotation_angle_deg(turn) == pytest.approx(
        abs(amount) if axis_unit(axis) == "deg" else 0.0, abs=EXACT
    )
    back = nudge(moved, axis, -amount, pivot_mm=pivot)
    np.testing.assert_allclose(back.target_from_source, ALIGNED.target_from_source, atol=EXACT)
    np.testing.assert_array_equal(moved.alignment_from_source, ALIGNED.alignment_from_source)


def test_an_edit_is_along_the_axes_of_the_target():
    # The bubble's camera is turned by 180 degrees about z: what is right for one is left for the
    # other.
    moved = nudge(ALIGNED, "x", 0.5, pivot_mm=np.zeros(3))
    shift = moved.target_from_source[:3, 3] - ALIGNED.target_from_source[:3, 3]
    np.testing.assert_allclose(shift, [0.5, 0.0, 0.0], atol=EXACT)


def test_the_pivot_is_the_middle_of_the_contact():
    depth = touched()
    z = float(GEL.rest_depth_mm[50, 320])
    ray_x, ray_y = GEL.camera.rays()
    middle = [z * (ray_x[319] + ray_x[320]) / 2, z * (ray_y[49] + ray_y[50]) / 2, z]
    np.testing.assert_allclose(
        compute_pivot_mm(depth, ALIGNED), rigid.apply(ALIGNED.target_from_source, middle), atol=1e-5
    )


def test_without_contact_the_pivot_is_the_middle_of_the_surface():
    depth = touched(rows=slice(0, 0))
    z, (ray_x, ray_y) = GEL.rest_depth_mm, GEL.camera.rays()
    middle = [(ray_x * z).mean(), (ray_y[:, None] * z).mean(), z.mean()]
    in_target = rigid.apply(ALIGNED.target_from_source, middle)
    np.testing.assert_allclose(compute_pivot_mm(depth, ALIGNED), in_target, atol=1e-5)
    left = np.where(np.arange(GEL.camera.cols) < 10, depth.depth_mm, np.nan)
    at_left = compute_pivot_mm(replace(depth, depth_mm=left), ALIGNED)
    middle = [
        (ray_x[:10] * z[:, :10]).mean(),
        (ray_y[:, None] * z[:, :10]).mean(),
        z[:, :10].mean(),
    ]
    np.testing.assert_allclose(at_left, rigid.apply(ALIGNED.target_from_source, middle), atol=1e-5)


def test_without_any_depth_the_pivot_is_the_camera_of_the_source():
    blind = touched()
    blind = replace(blind, depth_mm=np.full_like(blind.depth_mm, np.nan))
    np.testing.assert_allclose(
        compute_pivot_mm(blind, ALIGNED), ALIGNED.target_from_source[:3, 3], atol=EXACT
    )


def test_a_unit_whose_camera_stands_farther_back_sees_the_same_touch():
    shifted = shift_alignment_along_z(ALIGNED, source_shift_mm=1.5, target_shift_mm=-2.0)
    point = np.array([1.0, 2.0, 20.0])
    described = rigid.apply(ALIGNED.target_from_source, point + np.array([0.0, 0.0, 1.5]))
    np.testing.assert_allclose(
        rigid.apply(shifted.target_from_source, point),
        described + np.array([0.0, 0.0, 2.0]),
        atol=EXACT,
    )
    assert shift_alignment_along_z(ALIGNED, source_shift_mm=0.0, target_shift_mm=0.0) is ALIGNED
