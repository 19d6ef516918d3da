from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from pipeline.core.errors import SettingProblem
from pipeline.physics import bubble, lattice
from pipeline.sensors.spec import load_sensor

SPEC = load_sensor("soft_bubble")
BUBBLE = SPEC.bubble
ON = bubble.make_lattice(BUBBLE, 1.0)  # coarse, so that the tests are quick
X = ON.x_mm()[None, :]
Y = ON.y_mm()[:, None]
# ten times the solver's tolerance: a multigrid cycle that moves 1e-4 is within this of the end
SURFACE_MM = 1e-3


def plate(height_mm):
    return np.full(ON.shape, height_mm)


def ball(height_mm, radius_mm=10.0, x_mm=0.0, y_mm=0.0):
    r_sq = (X - x_mm) ** 2 + (Y - y_mm) ** 2
    inside = r_sq < radius_mm**2
    return np.where(
        inside, height_mm + radius_mm - np.sqrt(np.where(inside, radius_mm**2 - r_sq, 0.0)), np.inf
    )


def test_at_rest_it_is_the_dome_of_the_sensor_to_the_bit():
    at_rest = bubble.press_bubble(BUBBLE, plate(np.inf), ON)
    assert not at_rest.deviation_mm.any()
    assert at_rest.pressure_kpa == BUBBLE.pressure_kpa
    assert np.array_equal(
        bubble.compute_depth_from_deviation(SPEC, at_rest.deviation_mm, ON),
        SPEC.rest_depth_mm,
    )


def test_the_dome_solves_the_membrane_equation():
    """-T lap w = p on every inner node."""
    w = bubble.compute_rest_height_mm(BUBBLE, ON)
    lap = (
        w[2:, 1:-1] + w[:-2, 1:-1] + w[1:-1, 2:] + w[1:-1, :-2] - 4 * w[1:-1, 1:-1]
    ) / ON.step_mm**2
    inner = (X[:, 1:-1] / 55) ** 2 + (Y[1:-1] / 45) ** 2 < 1
    pressure_kpa = -lap * bubble.compute_tension_n_per_mm(BUBBLE) * 1e3
    assert np.abs(pressure_kpa[inner] - BUBBLE.pressure_kpa).max() < 1e-9


@settings(max_examples=20, deadline=None)
@given(
    st.floats(14.0, 19.0),
    st.floats(-4.0, 4.0),
    st.floats(14.0, 20.0),
    st.floats(-4.0, 4.0),
)
def test_a_membrane_from_another_touch_is_that_from_rest(before_mm, x_before, height_mm, x_mm):
    """Within what the pressure's tolerance leaves, however far the touches are apart."""
    last = bubble.press_bubble(BUBBLE, ball(before_mm, x_mm=x_before), ON).sealed
    ceiling = ball(height_mm, x_mm=x_mm)
    cold = bubble.press_bubble(BUBBLE, ceiling, ON)
    followed = bubble.press_bubble(BUBBLE, ceiling, ON, start=last)
    assert followed.converged == cold.converged
    assert np.abs(followed.deviation_mm - cold.deviation_mm).max() < SURFACE_MM
    assert followed.pressure_kpa == pytest.approx(cold.pressure_kpa, rel=1e-4)
    assert followed.is_followed == (ceiling < bubble.compute_rest_height_mm(BUBBLE, ON)).any()
    of_another_lattice = replace(last, deviation_mm=last.deviation_mm[1:])
    other = bubble.press_bubble(BUBBLE, ceiling, ON, start=of_another_lattice)
    assert other.deviation_mm.tobytes() == cold.deviation_mm.tobytes()
    assert not other.is_followed


def test_a_plate_on_a_round_bubble_follows_the_closed_form():
    """Annulus between contact radius c and rim a: w = A + B ln r - p r^2 / 4T with w(c) = g,
    w'(c) = 0, w(a) = 0.
    """
    a = 50.0
    height = 20.0
    gap = 15.0
    round_one = replace(
        BUBBLE, half_width_mm=a, half_height_mm=a, height_mm=height, dead_volume_mm3=1e13
    )
    on = bubble.make_lattice(round_one, 0.5)
    pressed = bubble.press_bubble(round_one, np.full(on.shape, gap), on)
    quarter = height / a**2  # p / 4T

    def rim_height(c):
        return gap + quarter * (c * c - a * a) + 2 * quarter * c * c * np.log(a / c)

    c = brentq(rim_height, 1e-3, a)
    assert pressed.converged
    assert np.sqrt(pressed.contact.sum() / np.pi) * on.step_mm == pytest.approx(
        c, abs=0.5 * on.step_mm
    )
    r = np.hypot(on.x_mm()[None, :], on.y_mm()[:, None])
    middle = (r > c + 1) & (r < a - 5)
    exact = gap + quarter * (c * c - r * r) + 2 * quarter * c * c * np.log(np.maximum(r, c) / c)
    w = bubble.compute_rest_height_mm(round_one, on) + pressed.deviation_mm
    # 0.1 % of the dome; the staircase of the rim decides it
    assert np.abs(w - exact)[middle].max() < 0.02
    assert pressed.force_n == pytest.approx(np.pi * c * c * 1e-3 * BUBBLE.pressure_kpa, rel=0.01)


@given(
    height=st.floats(2.0, 19.5),
    x=st.floats(-40, 40),
    y=st.floats(-30, 30),
    radius=st.floats(3.0, 40.0),
)
@settings(max_examples=15)
def test_every_press_is_complementary_and_keeps_boyles_law(height, x, y, radius):
    ceiling = ball(height, radius, x, y)
    pressed = bubble.press_bubble(BUBBLE, ceiling, ON)
    rest = bubble.compute_rest_height_mm(BUBBLE, ON)
    room = ceiling - rest - pressed.deviation_mm
    inside = bubble.find_free_nodes(BUBBLE, ON)
    assert pressed.converged
    assert room[inside].min() >= 0.0
    assert not pressed.contact_pressure_kpa[room > 1e-9].any()
    assert pressed.contact_pressure_kpa.min() >= 0.0
    air = BUBBLE.dead_volume_mm3 + bubble.compute_volume_mm3(BUBBLE)
    absolute = bubble.ATMOSPHERE_KPA + BUBBLE.pressure_kpa
    left = air + pressed.deviation_mm.sum() * ON.step_mm**2
    law = absolute * air / left - bubble.ATMOSPHERE_KPA
    # a micrometre over the whole dome is 1e-3 of it
    assert pressed.pressure_kpa == pytest.approx(law, rel=0.01)


def test_a_plate_gives_a_symmetric_shape():
    v = bubble.press_bubble(BUBBLE, plate(16.0), ON).deviation_mm
    assert np.abs(v - v[::-1]).max() < SURFACE_MM
    assert np.abs(v - v[:, ::-1]).max() < SURFACE_MM


def test_pressing_deeper_raises_pressure_force_and_bulge():
    shallow, deep = (bubble.press_bubble(BUBBLE, ball(h), ON) for h in (18.0, 12.0))
    assert BUBBLE.pressure_kpa < shallow.pressure_kpa < deep.pressure_kpa
    assert 0 < shallow.force_n < deep.force_n
    assert 0 < shallow.deviation_mm.max() < deep.deviation_mm.max()


def test_a_membrane_bridges_a_groove():
    grooved = np.where(
        np.abs(X) < 3, np.inf, np.where((np.abs(X) < 10) & (np.abs(Y) < 20), 15.0, np.inf)
    )
    pressed = bubble.press_bubble(BUBBLE, grooved, ON)
    row = ON.shape[0] // 2
    over_groove = (bubble.compute_rest_height_mm(BUBBLE, ON) + pressed.deviation_mm)[
        row, np.abs(X[0]) < 2
    ]
    assert (over_groove > 15.0).all()
    assert over_groove.max() < 16.0


@pytest.mark.parametrize("height", [19.999, 1.0, -5.0, -1000.0])
def test_extreme_depths_stay_finite(height):
    pressed = bubble.press_bubble(BUBBLE, plate(height), ON)
    assert np.isfinite(pressed.deviation_mm).all()
    assert np.isfinite(pressed.pressure_kpa)


def test_depth_to_ceiling_and_back_returns_the_surface():
    pressed = bubble.press_bubble(BUBBLE, ball(14.0, 20.0), ON)
    depth = bubble.compute_depth_from_deviation(SPEC, pressed.deviation_mm, ON)
    again = bubble.compute_ceiling_from_depth(SPEC, depth, ON)
    seen = np.isfinite(again)
    w = bubble.compute_rest_height_mm(BUBBLE, ON) + pressed.deviation_mm
    assert seen.sum() > 3000
    # chords of half-millimetre pixels over 1 mm lattice cells
    assert np.abs(again - w)[seen].max() < 0.02


def test_rays_meet_the_surface_to_the_nanometre():
    pressed = bubble.press_bubble(BUBBLE, ball(10.0, x_mm=12.0), ON)
    z = bubble.compute_depth_from_deviation(SPEC, pressed.deviation_mm, ON)
    ray_x, ray_y = SPEC.camera.rays()
    surface = replace(
        SPEC.membrane,
        x0_mm=ON.x0_mm,
        y0_mm=ON.y0_mm,
        step_mm=ON.step_mm,
        z_mm=bubble.compute_rest_z_mm(SPEC, ON) + pressed.deviation_mm,
    )
    assert np.abs(surface.depth_at(z * ray_x[None, :], z * ray_y[:, None]) - z).max() < 1e-6


def test_contact_is_in_its_place_in_the_image():
    pressed = bubble.press_bubble(BUBBLE, ball(13.0, x_mm=10.0, y_mm=-5.0), ON)
    depth = bubble.compute_depth_from_deviation(SPEC, pressed.deviation_mm, ON)
    seen = lattice.sample_mask_at_pixels(SPEC.camera, pressed.contact, ON, depth)
    points = SPEC.camera.back_project(depth)[seen]
    where = pressed.contact.nonzero()
    # a third of a lattice step
    assert points[:, 0].mean() == pytest.approx(X[0, where[1]].mean(), abs=0.3)
    assert points[:, 1].mean() == pytest.approx(Y[where[0], 0].mean(), abs=0.3)


def test_invalid_bubbles_are_refused():
    with pytest.raises(SettingProblem, match="positive"):
        bubble.press_bubble(replace(BUBBLE, pressure_kpa=0.0), plate(10.0), ON)
