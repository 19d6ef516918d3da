"""The scenes of tasks against closed forms of rigid body mechanics, within 5 %."""

import math

import numpy as np
import pytest

from pipeline.core.geometry import rigid
from pipeline.lab.tasks.grasp import PlanarPose
from pipeline.lab.tasks.insertion import BEYOND_MM, STIFFNESS_N_MM, cut_peg, insert
from pipeline.lab.tasks.marble import TICK_S, RollingBall
from pipeline.lab.tasks.scene import GRAVITY_MM_S2, Scene, write_pose
from pipeline.physics.simulation.shapes.solids import make_chamfered_prism, transform_mesh

WITHIN = 0.05
RADIUS_MM = 8.0
MASS_KG = 0.005


def make_ball_on_slope(slope_deg, friction):
    slope = rigid.rotation((0.0, math.radians(slope_deg), 0.0))
    above = slope @ rigid.translation(0.0, 0.0, RADIUS_MM)
    return Scene(
        f'<geom type="plane" size="10 10 1" friction="{friction}" condim="3" {write_pose(slope)}/>'
        f'<body name="ball" {write_pose(above)}><freejoint/>'
        f'<geom type="sphere" size="{1e-3 * RADIUS_MM}" mass="{MASS_KG}" friction="{friction}" '
        'condim="3"/></body>'
    )


def measure_acceleration(scene, duration_s=0.5):
    scene.advance(duration_s)
    return measure_speed_mm_s(scene) / scene.time_s


def measure_speed_mm_s(scene):
    return 1e3 * np.linalg.norm(scene._data.qvel[:3])  # of the only free body


@pytest.mark.parametrize("slope_deg", [5.0, 15.0, 25.0])
def test_ball_rolls_down_a_slope_at_five_sevenths_of_sliding(slope_deg):
    expected = 5.0 / 7.0 * GRAVITY_MM_S2 * math.sin(math.radians(slope_deg))
    assert measure_acceleration(make_ball_on_slope(slope_deg, 0.5)) == pytest.approx(
        expected, rel=WITHIN
    )


def test_ball_slips_where_friction_is_too_low_to_roll():
    slope = math.radians(30.0)
    friction = 0.05
    assert friction < 2.0 / 7.0 * math.tan(slope)
    expected = GRAVITY_MM_S2 * (math.sin(slope) - friction * math.cos(slope))
    assert measure_acceleration(make_ball_on_slope(30.0, friction)) == pytest.approx(
        expected, rel=WITHIN
    )


def test_contact_force_of_a_ball_at_rest_is_its_weight():
    scene = make_ball_on_slope(0.0, 0.5)
    scene.advance(0.5)
    weight_n = MASS_KG * 1e-3 * GRAVITY_MM_S2
    assert scene.measure_contact_force("ball") == pytest.approx(
        (0.0, 0.0, weight_n), abs=WITHIN * weight_n
    )


def test_rolling_keeps_energy():
    scene = make_ball_on_slope(15.0, 0.5)
    scene.advance(0.05)
    speed_before = measure_speed_mm_s(scene)
    z_before = scene.get_pose("ball")[2, 3]
    scene.advance(0.5)
    potential = GRAVITY_MM_S2 * (z_before - scene.get_pose("ball")[2, 3])
    assert 0.7 * (measure_speed_mm_s(scene) ** 2 - speed_before**2) == pytest.approx(
        potential, rel=WITHIN
    )


def test_rolling_friction_stops_a_ball_after_the_way_of_its_energy():
    lever_mm = 0.2
    speed_mm_s = 100.0
    rough = f'condim="6" friction="0.5 0.001 {1e-3 * lever_mm}"'
    scene = Scene(
        f'<geom type="plane" size="10 10 1" {rough}/><body name="ball" pos="0 0 '
        f'{1e-3 * RADIUS_MM}"><freejoint/>'
        f'<geom type="sphere" size="{1e-3 * RADIUS_MM}" mass="{MASS_KG}" {rough}/></body>'
    )
    scene._data.qvel[:6] = (1e-3 * speed_mm_s, 0.0, 0.0, 0.0, speed_mm_s / RADIUS_MM, 0.0)
    scene.advance(1.5)
    # 7/10 m v^2 of a rolling ball over the torque's work per mm, m g lever / R.
    expected_mm = 0.7 * speed_mm_s**2 * RADIUS_MM / (GRAVITY_MM_S2 * lever_mm)
    assert scene.get_pose("ball")[0, 3] == pytest.approx(expected_mm, rel=WITHIN)
    assert measure_speed_mm_s(scene) < 0.01 * speed_mm_s


def test_a_ball_between_plate_and_cover_follows_the_plate_by_half():
    ball = RollingBall((2.0, -1.0), load_n=1.5)
    ticks = [ball.move_plate(np.array([0.3, -0.2])) for _ in range(10)] + [
        ball.move_plate(np.zeros(2))
    ]
    moved = ticks[-1].world_from_hand[:2, 3]
    assert moved == pytest.approx((3.0, -2.0), rel=WITHIN)
    assert ticks[-1].world_from_object[:2, 3] - (2.0, -1.0) == pytest.approx(
        0.5 * moved, rel=WITHIN
    )
    assert ball.contact_mm - (2.0, -1.0) == pytest.approx(-0.5 * moved, rel=WITHIN)
    assert ticks[-1].force_n[2] == pytest.approx(1.5, rel=WITHIN)
    assert ticks[-1].time_s == pytest.approx(11 * TICK_S)


def test_a_jammed_peg_presses_as_the_hand_is_stiff_and_its_own_weight_does_not_count():
    square = make_chamfered_prism([(-4, -4), (4, -4), (4, 4), (-4, 4)], 30.0, 0.001, "peg")
    peg = cut_peg(transform_mesh(square, rigid.rotation((0.0, -0.5 * math.pi, 0.0))), 8.0)
    jam = insert(
        peg,
        np.eye(4),
        PlanarPose(y_mm=2.0).matrix,
        clearance_mm=0.5,
        lead_in_mm=0.0,
        force_limit_n=1e3,
    )
    overtravel_mm = peg.depth_mm + BEYOND_MM
    assert jam.ticks[-1].force_n[2] == pytest.approx(STIFFNESS_N_MM * overtravel_mm, rel=WITHIN)


@pytest.mark.parametrize("clearance_mm", [0.5, 1.0])
@pytest.mark.parametrize(("share", "goes_in"), [(0.0, True), (0.95, True), (1.05, False)])
def test_peg_jams_where_its_offset_exceeds_half_the_clearance(clearance_mm, share, goes_in):
    square = make_chamfered_prism([(-4, -4), (4, -4), (4, 4), (-4, 4)], 30.0, 0.001, "peg")
    peg = cut_peg(transform_mesh(square, rigid.rotation((0.0, -0.5 * math.pi, 0.0))), 8.0)
    believed = PlanarPose(y_mm=0.5 * share * clearance_mm).matrix
    descent = insert(
        peg, np.eye(4), believed, clearance_mm=clearance_mm, lead_in_mm=0.0, force_limit_n=15.0
    )
    assert descent.succeeds == goes_in, descent.cause
