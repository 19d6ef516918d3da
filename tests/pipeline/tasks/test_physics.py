"""The scenes of tasks against closed forms of rigid body mechanics, within 5 %."""

import math

import numpy as np
import pytest

from pipeline.geometry import rigid
from pipeline.simulation.shapes.prisms import make_chamfered_prism
from pipeline.simulation.shapes.solids import transform_mesh
from pipeline.tasks.descent import insert
from pipeline.tasks.in_hand import PlanarPose
from pipeline.tasks.peg import cut_peg
from pipeline.tasks.scene import GRAVITY_MM_S2, Scene, write_pose

WITHIN = 0.05
RADIUS_MM, MASS_KG = 8.0, 0.005


def make_ball_on_slope(slope_deg, friction):
    slope = rigid.rotation((0.0, math.radians(slope_deg), 0.0))
    above = slope @ rigid.translation(0.0, 0.0, RADIUS_MM)
    return Scene(
        f'<geom type="plane" size="10 10 1" friction="{friction}" condim="3" {write_pose(slope)}/>'
        f'<body name="ball" {write_pose(above)}><freejoint/>'
        f'<geom type="sphere" size="{1e-3 * RADIUS_MM}" mass="{MASS_KG}" friction="{friction}" condim="3"/></body>'
    )


def measure_acceleration(scene, duration_s=0.5):
    scene.advance(duration_s)
    return np.linalg.norm(scene.get_velocity("ball")[:3]) / scene.time_s


@pytest.mark.parametrize("slope_deg", [5.0, 15.0, 25.0])
def test_ball_rolls_down_a_slope_at_five_sevenths_of_sliding(slope_deg):
    expected = 5.0 / 7.0 * GRAVITY_MM_S2 * math.sin(math.radians(slope_deg))
    assert measure_acceleration(make_ball_on_slope(slope_deg, 0.5)) == pytest.approx(expected, rel=WITHIN)


def test_ball_slips_where_friction_is_too_low_to_roll():
    slope, friction = math.radians(30.0), 0.05
    assert friction < 2.0 / 7.0 * math.tan(slope)
    expected = GRAVITY_MM_S2 * (math.sin(slope) - friction * math.cos(slope))
    assert measure_acceleration(make_ball_on_slope(30.0, friction)) == pytest.approx(expected, rel=WITHIN)


def test_contact_force_of_a_ball_at_rest_is_its_weight():
    scene = make_ball_on_slope(0.0, 0.5)
    scene.advance(0.5)
    weight_n = MASS_KG * 1e-3 * GRAVITY_MM_S2
    assert scene.measure_contact_force("ball") == pytest.approx((0.0, 0.0, weight_n), abs=WITHIN * weight_n)


def test_rolling_keeps_energy():
    scene = make_ball_on_slope(15.0, 0.5)
    scene.advance(0.05)
    before, z_before = scene.compute_energy_mj(), scene.get_pose("ball")[2, 3]
    scene.advance(0.5)
    potential_mj = MASS_KG * 1e-3 * GRAVITY_MM_S2 * (z_before - scene.get_pose("ball")[2, 3])
    assert abs(scene.compute_energy_mj() - before) < WITHIN * potential_mj


@pytest.mark.parametrize("clearance_mm", [0.5, 1.0])
@pytest.mark.parametrize(("share", "goes_in"), [(0.0, True), (0.95, True), (1.05, False)])
def test_peg_jams_where_its_offset_exceeds_half_the_clearance(clearance_mm, share, goes_in):
    square = make_chamfered_prism([(-4, -4), (4, -4), (4, 4), (-4, 4)], 30.0, 0.001, "peg")
    peg = cut_peg(transform_mesh(square, rigid.rotation((0.0, -0.5 * math.pi, 0.0))), 8.0)
    believed = PlanarPose(y_mm=0.5 * share * clearance_mm).matrix
    descent = insert(peg, np.eye(4), believed, clearance_mm=clearance_mm, lead_in_mm=0.0, force_limit_n=15.0)
    assert descent.succeeds == goes_in, descent.cause
