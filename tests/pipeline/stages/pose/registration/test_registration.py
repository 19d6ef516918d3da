from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.errors import CalibrationError
from pipeline.core.geometry import rigid
from pipeline.core.geometry.distance_grid import build_grid
from pipeline.core.geometry.meshes import sample_surface
from pipeline.stages.pose.registration.gauss_newton import (
    CentredPoints,
    FitOptions,
    NotDetermined,
    PoseFit,
    fit_pose,
)
from pipeline.stages.pose.registration.observability import assess_observability
from tests.pipeline.stages.pose.registration.solids import ball, l_bar, notched_wedge, rod, slab

POSITION_TOLERANCE_MM = 0.01  # the wedge has edges, which the grid rounds within its step of 0.1 mm
TURN_TOLERANCE_DEG = 0.1  # the same over 6 mm
SETTLED_MM = 1e-4  # iterations end at motions of 1e-4 mm, each a tenth of the one before
ROUNDING_MM = 1e-9  # of double precision at 1e6 mm, which holds 1e-10 mm


@pytest.fixture(scope="module")
def wedge():
    """The grid of the wedge, and points of its roof and of the walls of its notch."""
    points, normals = sample_surface(notched_wedge().mesh, 6000, 0)
    roof = (normals[:, 2] > -0.1) & (np.abs(points[:, 1]) < 4.5) & (points[:, 2] > 0.2)
    grid = build_grid(notched_wedge().mesh)
    roof &= grid.at(points + 0.1 * normals)[0] > 0.05  # not between its parts
    return grid, points[roof][:1500]


def register_points(points, grid, start, how=None):
    centred = CentredPoints.from_points(points)
    return (
        centred
        if isinstance(centred, NotDetermined)
        else fit_pose(centred, grid, start, how or FitOptions())
    )


def error(found, truth, points):
    middle = points.mean(axis=0)
    off = found @ rigid.invert(truth)
    return np.linalg.norm(rigid.apply(off, middle) - middle), rigid.rotation_angle_deg(off)


def off_by(truth, points, turn_rad, shift_mm):
    middle = points.mean(axis=0)
    return (
        rigid.translation(*(middle + shift_mm))
        @ rigid.rotation(turn_rad)
        @ rigid.translation(*-middle)
        @ truth
    )


vectors = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)


@settings(max_examples=25)
@given(turn=vectors, place=vectors, off_turn=vectors, off_shift=vectors)
def test_any_pose_is_recovered_from_nearby(wedge, turn, place, off_turn, off_shift):
    grid, points = wedge
    truth = rigid.rotation(3.0 * turn)
    truth[:3, 3] = 100.0 * place
    points_in_sensor = rigid.apply(truth, points)
    found = register_points(
        points_in_sensor, grid, off_by(truth, points_in_sensor, 0.06 * off_turn, 0.3 * off_shift)
    )
    assert isinstance(found, PoseFit)
    assert found.fitness == 1.0
    mm, deg = error(found.sensor_from_object, truth, points_in_sensor)
    assert mm < POSITION_TOLERANCE_MM
    assert deg < TURN_TOLERANCE_DEG


@pytest.mark.parametrize("far_mm", [1.0, 1e3, 1e6])
def test_a_frame_elsewhere_changes_nothing_but_rounding(wedge, far_mm):
    grid, points = wedge
    start = off_by(np.eye(4), points, np.array([0.05, 0.0, -0.04]), np.array([0.2, 0.1, 0.0]))
    moved = rigid.from_parts([far_mm, -far_mm, 0.5 * far_mm], [20.0, 50.0, -70.0])
    here = register_points(points, grid, start)
    there = register_points(rigid.apply(moved, points), grid, moved @ start)
    mm, deg = error(
        there.sensor_from_object, moved @ here.sensor_from_object, rigid.apply(moved, points)
    )
    # The points themselves are rounded by the frame; the kinks of the lattice pass on some hundred
    # times that.
    assert mm < ROUNDING_MM * max(1.0, 100 * far_mm / 1e6) + SETTLED_MM / 10
    assert deg < 1e-3


def test_the_order_of_the_points_changes_nothing_but_rounding(wedge):
    grid, points = wedge
    start = off_by(np.eye(4), points, np.array([0.05, 0.0, -0.04]), np.array([0.2, 0.1, 0.0]))
    mixed = points[np.random.default_rng(0).permutation(len(points))]
    one, other = (register_points(p, grid, start).sensor_from_object for p in (points, mixed))
    np.testing.assert_allclose(one, other, atol=ROUNDING_MM)
    assert one.tobytes() == register_points(points, grid, start).sensor_from_object.tobytes()


def test_many_points_begin_with_few_and_end_at_the_same_place(wedge):
    grid, points = wedge
    start = off_by(np.eye(4), points, np.array([0.05, 0.0, -0.04]), np.array([0.2, 0.1, 0.0]))
    many = np.repeat(points, 3, axis=0)
    one, other = (register_points(p, grid, start).sensor_from_object for p in (points, many))
    np.testing.assert_allclose(one, other, atol=SETTLED_MM)


def test_outliers_and_what_is_not_finite_are_no_matter(wedge):
    grid, points = wedge
    rng = np.random.default_rng(2)
    spoiled = points.copy()
    spoiled[::7] += rng.uniform(0.3, 1.5, (len(spoiled[::7]), 3))
    spoiled[::50] = np.nan
    start = off_by(np.eye(4), points, np.array([0.03, 0.0, -0.02]), np.array([0.1, 0.1, 0.0]))
    mm, deg = error(register_points(spoiled, grid, start).sensor_from_object, np.eye(4), points)
    assert mm < 2 * POSITION_TOLERANCE_MM
    assert deg < 2 * TURN_TOLERANCE_DEG


def patch(mesh, axis_normal, half_mm):
    points, normals = sample_surface(mesh, 20_000, 1)
    chosen = (
        (normals @ axis_normal > 0.5)
        & (np.abs(points[:, 0]) < half_mm)
        & (np.abs(points[:, 1]) < half_mm)
    )
    return points[chosen][:2500]


@pytest.mark.parametrize(
    ("mesh", "slide_mm"),
    [(rod(sides=256).mesh, 1.5), (slab().mesh, 1.5), (ball(6.0), 0.0)],
    ids=["rod", "plane", "sphere"],
)
def test_what_the_points_do_not_show_stays_where_it_was(mesh, slide_mm):
    grid = build_grid(mesh)
    points = patch(mesh, np.array([0.0, 0.0, 1.0]), 5.0)
    found = register_points(points, grid, rigid.translation(slide_mm, 0.0, 0.2))
    assert found.sensor_from_object[0, 3] == pytest.approx(slide_mm, abs=0.02), "it did not slide"
    assert abs(found.sensor_from_object[2, 3]) < POSITION_TOLERANCE_MM, "what is shown was found"


def test_too_little_is_told_and_never_a_number():
    grid = build_grid(l_bar().mesh)
    for points in (
        np.zeros((0, 3)),
        np.zeros((5, 3)),
        np.ones((50, 3)),
        np.full((50, 3), np.nan),
        np.random.default_rng(0).uniform(-1, 1, (50, 3)) + 1e5,
        np.arange(50)[:, None] * np.full(3, 1e306),
    ):
        found = register_points(points, grid, np.eye(4))
        assert isinstance(found, NotDetermined)
        assert found.reason
    with pytest.raises(CalibrationError, match="start"):
        register_points(
            np.random.default_rng(0).uniform(-1, 1, (50, 3)), grid, np.full((4, 4), np.nan)
        )


def test_steps_begin_at_the_start_and_end_at_the_answer(wedge):
    grid, points = wedge
    start = off_by(np.eye(4), points, np.array([0.05, 0.0, -0.04]), np.array([0.2, 0.1, 0.0]))
    found = register_points(points, grid, start, FitOptions(keep_steps=True))
    assert 3 < len(found.steps) <= FitOptions().n_iterations + 1
    np.testing.assert_allclose(found.steps[0].sensor_from_object, start, atol=1e-12)
    np.testing.assert_array_equal(found.steps[-1].sensor_from_object, found.sensor_from_object)
    assert found.steps[-1].rmse_mm < found.steps[0].rmse_mm


def held_by_the_kernel(information, asked):
    """(how many directions are held, (6, 6) that takes the motion the points ask for to the
    step).
    """
    from pipeline.stages.pose.registration.registration_kernels import solve_step

    sums = np.zeros(28)
    columns = []
    sums[:21], sums[27] = information[np.triu_indices(6)], 1.0
    for k in range(6):
        motion = np.empty(6)
        sums[21:27] = information[:, k]
        n_held = solve_step(sums, asked, (np.empty((6, 6)), np.empty((6, 6))), motion)
        columns.append(motion)
    return n_held, np.array(columns).T


@settings(max_examples=30)
@given(seed=st.integers(0, 2**31), flatness=st.sampled_from([0.0, 0.01, 0.05, 0.2, 1.0]))
def test_the_iterations_hold_as_many_directions_as_observability_calls_weak(seed, flatness):
    rng = np.random.default_rng(seed)
    arms = rng.uniform(-4, 4, (200, 3)) * (1.0, 1.0, flatness)
    arms -= arms.mean(axis=0)
    normals = rng.standard_normal((200, 3)) * flatness + (0.0, 0.0, -1.0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    radius_mm = np.sqrt((arms**2).sum(axis=1).mean())
    rows = np.hstack([np.cross(arms, normals) / radius_mm, normals])
    fake = np.deg2rad(3.0) ** 2
    variance = 0.06**2 / 200
    asked = np.repeat(
        [fake + variance / (np.deg2rad(1.0) * radius_mm) ** 2, fake + variance / 0.2**2], 3
    )
    n_held, step = held_by_the_kernel(rows.T @ rows / 200, asked)
    assert n_held == len(assess_observability(arms, normals, np.zeros(3), 0.06).weak_directions)
    np.testing.assert_allclose(step @ step, step, atol=1e-6)
    assert round(float(np.trace(step))) == 6 - n_held


@pytest.mark.parametrize("exponent", range(17))
def test_a_direction_is_held_exactly_where_its_predicted_spread_exceeds_the_tolerance(exponent):
    value = 10.0**-exponent
    variance = 0.03**2 / 1000.0
    tolerance_mm = 0.2
    asked = np.full(6, variance / tolerance_mm**2)
    n_held, step = held_by_the_kernel(np.diag([0.5, 0.5, 0.5, 1.0, 1.0, value]), asked)
    is_held = np.sqrt(variance / value) > tolerance_mm
    assert n_held == int(is_held)
    np.testing.assert_allclose(step, np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 1.0 - is_held]), atol=1e-4)
