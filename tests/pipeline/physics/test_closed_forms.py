"""The contact solvers against closed forms: Hertz, Sneddon's punch and cone, the clamped
membrane.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from pipeline.physics import bubble, gel
from pipeline.sensors.parts import Gel
from pipeline.sensors.spec import load_sensor

HALF_SPACE = Gel(thickness_mm=math.inf, youngs_kpa=120.0, poisson=0.48)
EFFECTIVE_N_MM2 = 0.12 / (1 - 0.48**2)
PAD = Gel(thickness_mm=2.0, youngs_kpa=120.0, poisson=0.48)
SURFACE_RMS_MM = 1e-4  # a tenth of a micrometre: what the simulator promises
RADIUS_SHARE = 0.01  # of the contact radius: pixels are counted whole
FORCE_SHARE = 0.005
BUBBLE = load_sensor("soft_bubble").bubble
# so much air is no spring
ROUND = replace(BUBBLE, half_width_mm=50.0, half_height_mm=50.0, dead_volume_mm3=1e13)


def radius_mm(shape, pixel_mm):
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.hypot(y - (shape[0] - 1) / 2, x - (shape[1] - 1) / 2) * pixel_mm


def disc_mm(mask, pixel_mm):
    """Radius of the disc with the area of a mask."""
    return math.sqrt(mask.sum() / math.pi) * pixel_mm


def hertz(shape, pixel_mm, ball_mm, depth_mm):
    """(overlap, exact indentation, exact contact radius) of Hertz' paraboloid on a half-space."""
    r = radius_mm(shape, pixel_mm)
    a = math.sqrt(ball_mm * depth_mm)
    overlap = depth_mm - r * r / (2 * ball_mm)
    far = np.maximum(r, a * (1 + 1e-12))
    free = ((2 * a * a - far * far) * np.arcsin(a / far) + a * np.sqrt(far * far - a * a)) / (
        math.pi * ball_mm
    )
    return overlap, np.where(r < a, overlap, free), a


def test_a_ball_on_a_whole_pad_is_hertz():
    """4 mm ball, 0.5 mm deep, on an 18.6 mm wide half-space seen by 320 x 427 pixels."""
    shape = (320, 427)
    pixel_mm = 18.6 / 427
    overlap, exact, a = hertz(shape, pixel_mm, 4.0, 0.5)
    pressed = gel.press_gel(HALF_SPACE, pixel_mm, overlap)
    assert disc_mm(pressed.contact, pixel_mm) == pytest.approx(a, rel=RADIUS_SHARE)
    assert pressed.force_n == pytest.approx(
        4 / 3 * EFFECTIVE_N_MM2 * 2.0 * 0.5**1.5, rel=FORCE_SHARE
    )
    assert math.sqrt(((pressed.indentation_mm - exact) ** 2).mean()) <= SURFACE_RMS_MM


def test_a_ball_has_the_pressure_of_hertz():
    shape = (161, 161)
    pixel_mm = 0.05
    overlap, _, a = hertz(shape, pixel_mm, 4.0, 0.5)
    pressed = gel.press_gel(HALF_SPACE, pixel_mm, overlap)
    r = radius_mm(shape, pixel_mm)
    peak_kpa = 2e3 * EFFECTIVE_N_MM2 * a / (math.pi * 4.0)
    inner = r < 0.9 * a  # the slope at the edge is infinite
    exact = peak_kpa * np.sqrt(1 - (r[inner] / a) ** 2)
    # a pixel is 3.5 % of the radius
    assert np.abs(pressed.pressure_kpa[inner] - exact).max() < 0.01 * peak_kpa


def test_a_flat_punch_has_the_pressure_and_force_of_sneddon():
    shape = (161, 161)
    pixel_mm = 0.05
    depth = 0.2
    r = radius_mm(shape, pixel_mm)
    pressed = gel.press_gel(HALF_SPACE, pixel_mm, np.where(r < 2.0, depth, -np.inf))
    a = disc_mm(r < 2.0, pixel_mm)
    # the rim is half a pixel soft
    assert pressed.force_n == pytest.approx(2 * a * EFFECTIVE_N_MM2 * depth, rel=0.015)
    inner = r < 0.8 * a  # the pressure at the rim is infinite
    exact_kpa = 1e3 * EFFECTIVE_N_MM2 * depth / (math.pi * np.sqrt(a * a - r[inner] ** 2))
    assert np.abs(pressed.pressure_kpa[inner] / exact_kpa - 1).max() < 0.02


@pytest.mark.parametrize("slope", [0.1, 0.3])
def test_a_cone_has_the_contact_and_force_of_sneddon(slope):
    """For a surface that falls by `slope` per length: a = 2 d / (pi slope), F = 2 E* d^2 / (pi
    slope).
    """
    shape = (201, 201)
    pixel_mm = 0.05
    a = 3.0
    depth = math.pi / 2 * a * slope
    pressed = gel.press_gel(HALF_SPACE, pixel_mm, depth - slope * radius_mm(shape, pixel_mm))
    assert disc_mm(pressed.contact, pixel_mm) == pytest.approx(a, rel=RADIUS_SHARE)
    assert pressed.force_n == pytest.approx(
        2 / math.pi * EFFECTIVE_N_MM2 * depth**2 / slope, rel=FORCE_SHARE
    )


def test_far_away_presses_add_up():
    """Two single loaded pixels move the pad as the sum of each.

    Far away only the sum of a load counts.
    """
    layer = gel.make_elastic_layer(HALF_SPACE, 0.1, (96, 128))
    one, other, both = (np.zeros((96, 128), np.float32) for _ in range(3))
    one[20, 30] = 50.0
    other[70, 100] = 20.0
    both[20, 30] = 50.0
    both[70, 100] = 20.0
    total = layer.compute_displacement(one) + layer.compute_displacement(other)
    # single precision
    assert np.abs(layer.compute_displacement(both) - total).max() < 1e-6 * total.max()
    y, x = np.mgrid[:96, :128]
    far = np.hypot(y - 20, x - 30) * 0.1
    boussinesq = 50.0e-3 * 0.1**2 / (math.pi * EFFECTIVE_N_MM2 * np.maximum(far, 0.1))
    assert np.abs(layer.compute_displacement(one) / boussinesq - 1)[far > 2.0].max() < 1e-3


def test_twice_the_pixels_halve_the_error_at_least():
    errors = []
    for n in (41, 81, 161):
        pixel_mm = 6.0 / n
        overlap, exact, _ = hertz((n, n), pixel_mm, 3.0, 0.4)
        pressed = gel.press_gel(HALF_SPACE, pixel_mm, overlap, tolerance_mm=1e-6)
        errors.append(math.sqrt(((pressed.indentation_mm - exact) ** 2).mean()))
    assert math.log2(errors[0] / errors[2]) / 2 > 0.9


def test_pressure_and_gap_exclude_each_other():
    rng = np.random.default_rng(3)
    overlap = 0.4 * rng.random((120, 150)) - 0.1
    pressed = gel.press_gel(PAD, 0.05, overlap)
    gap = pressed.indentation_mm - overlap
    assert pressed.converged
    # kPa times 0.3 um
    assert (pressed.pressure_kpa * np.abs(gap)).max() < 3e-4 * pressed.pressure_kpa.max()


@pytest.mark.parametrize("turned", ["left-right", "up-down"])
def test_a_mirrored_object_leaves_the_mirrored_mark(turned):
    flip = (
        (slice(None), slice(None, None, -1))
        if turned == "left-right"
        else (slice(None, None, -1), slice(None))
    )
    rng = np.random.default_rng(4)
    overlap = np.where(rng.random((60, 70)) < 0.3, 0.3 * rng.random((60, 70)), -1.0)
    one = gel.press_gel(PAD, 0.06, overlap)
    other = gel.press_gel(PAD, 0.06, overlap[flip])
    assert np.abs(one.indentation_mm[flip] - other.indentation_mm).max() < 3e-4
    assert one.force_n == pytest.approx(other.force_n, rel=1e-3)


def inflated(on, membrane, load_per_mm):
    grid = bubble.ObstacleProblem(
        clearance_mm=np.full(on.shape, np.inf),
        free=bubble.find_free_nodes(membrane, on),
        step_mm=on.step_mm,
    )
    v, _, settled = bubble.solve_obstacle(grid, np.zeros(on.shape), load_per_mm, 1e-8)
    return v, settled


@pytest.mark.parametrize("membrane", [ROUND, BUBBLE], ids=["circle", "ellipse"])
def test_a_clamped_membrane_rises_by_its_pressure(membrane):
    """Circle w = p (a^2 - r^2) / 4T.

    Ellipse w = p / 2T (1 - (x/a)^2 - (y/b)^2) / (1/a^2 + 1/b^2).
    """
    on = bubble.make_lattice(membrane)
    load = 0.004
    w, settled = inflated(on, membrane, load)
    top = load / 2 / (membrane.half_width_mm**-2 + membrane.half_height_mm**-2)
    assert settled
    middle = w[on.shape[0] // 2, on.shape[1] // 2]
    assert middle == pytest.approx(top, rel=1e-3)


def test_the_rest_dome_is_the_clamped_membrane_itself():
    tension = bubble.compute_tension_n_per_mm(ROUND)
    on = bubble.make_lattice(ROUND, 0.5)
    exact = ROUND.pressure_kpa * 1e-3 * (50.0**2 - on.x_mm() ** 2) / (4 * tension)
    across = bubble.compute_rest_height_mm(ROUND, on)[on.shape[0] // 2]
    assert np.abs(across - np.maximum(exact, 0.0)).max() < 1e-3 * exact.max()


def test_a_finer_bubble_is_nearer_to_the_plate_on_a_circle():
    """The air held so that it cannot be squeezed, w'' = -p/T outside the contact radius c of the
    closed form.
    """
    from scipy.optimize import brentq

    gap = 15.0
    a = 50.0
    quarter = BUBBLE.height_mm / 50.0**2
    c = brentq(
        lambda c: gap + quarter * (c * c - a * a) + 2 * quarter * c * c * np.log(a / c), 1e-3, a
    )
    errors = []
    for step_mm in (2.0, 1.0, 0.5):
        on = bubble.make_lattice(ROUND, step_mm)
        pressed = bubble.press_bubble(ROUND, np.full(on.shape, gap), on, tolerance_mm=1e-6)
        r = np.hypot(on.x_mm()[None, :], on.y_mm()[:, None])
        exact = gap + quarter * (c * c - r * r) + 2 * quarter * c * c * np.log(np.maximum(r, c) / c)
        off = (
            bubble.compute_rest_height_mm(ROUND, on)
            + pressed.deviation_mm
            - np.where(r < c, gap, exact)
        )
        errors.append(math.sqrt((off[r < a - 4] ** 2).mean()))
    assert 0.7 < math.log2(errors[0] / errors[2]) / 2 < 2.3


def test_a_bubble_on_pins_is_solved_as_by_an_active_set():
    """Every held node has a force, every loose one solves the equation, and none passes the
    object.
    """
    on = bubble.make_lattice(BUBBLE, 1.0)
    rng = np.random.default_rng(5)
    ceiling = np.full(on.shape, np.inf)
    ceiling[rng.integers(10, 90, 30), rng.integers(10, 110, 30)] = rng.uniform(-5, 18, 30)
    free = bubble.find_free_nodes(BUBBLE, on)
    grid = bubble.ObstacleProblem(
        clearance_mm=ceiling - bubble.compute_rest_height_mm(BUBBLE, on), free=free, step_mm=1.0
    )
    v, _, settled = bubble.solve_obstacle(grid, np.zeros(on.shape), 0.003, 1e-7)
    left = np.zeros(on.shape)
    left[1:-1, 1:-1] = (
        0.003 + v[2:, 1:-1] + v[:-2, 1:-1] + v[1:-1, 2:] + v[1:-1, :-2] - 4 * v[1:-1, 1:-1]
    )
    on_object = free & (v >= grid.clearance_mm)
    assert settled
    assert on_object.any()
    assert (v <= grid.clearance_mm)[free].all()
    assert np.abs(left[free & ~on_object]).max() < 1e-6
    assert left[on_object].min() > -1e-6
