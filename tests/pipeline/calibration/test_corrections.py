from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from pipeline.calibration import corrections, slope_model
from pipeline.calibration.ball_presses import BallPress, BallSlopeProfile, sample_contact
from pipeline.calibration.balls import calibrate_balls
from pipeline.calibration.calibration_table import compute_relative_change, make_built_in
from pipeline.calibration.contact_circles import Circle
from pipeline.calibration.corrections import (
    HeldOutErrors,
    choose_candidate,
    compute_coverage_map,
    has_low_coverage,
    measure_diameter_error,
    summarise_errors,
)
from pipeline.calibration.shading_field import ShadingFieldPrior
from pipeline.physics import optics
from pipeline.physics.simulation.variation import vary_sensor
from pipeline.sensors.spec import load_sensor
from tests.pipeline.calibration.test_balls import hertz

FEW_PRESSES_TOLERANCE = 0.12  # of the diameter, median: what four presses promise
PLACES = [(90, 70), (230, 80), (110, 170), (220, 165)]
ELSEWHERE = [(160, 120), (60, 130), (270, 120), (160, 50), (165, 200)]


def press(unit, x_px, y_px, diameter_mm, seed):
    return optics.render(
        unit, hertz(unit.camera.shape, unit.pixel_mm, x_px, y_px, diameter_mm, 0.6), seed=seed
    )


@pytest.fixture(scope="module")
def another_unit():
    """A unit unlike the description, its still picture, and the calibration from four presses."""
    unit = vary_sensor(load_sensor("gelsight_mini"), 11, 2.5)
    still = optics.render_reference(unit)
    pictures = [press(unit, x, y, 6.31, i) for i, (x, y) in enumerate(PLACES)]
    return unit, still, calibrate_balls(pictures, still, load_sensor("gelsight_mini"), 6.31)


def errors_elsewhere(model, unit, still):
    found = []
    for k, (x, y) in enumerate(ELSEWHERE):
        change = compute_relative_change(press(unit, x, y, 9.5, 30 + k), still, unit.pixel_mm)
        radius_px = np.sqrt(4.75 * 0.6) / unit.pixel_mm
        seen = BallPress(index=0, change=change, circle=Circle(x_px=x, y_px=y, radius_px=radius_px))
        ball = BallSlopeProfile(radius_px=4.75 / unit.pixel_mm, sphere_slope_share=None)
        samples = sample_contact(seen, ball)
        found.append(abs(measure_diameter_error(slope_model.predict(model, samples), samples)))
    return np.array(found)


def test_four_presses_measure_another_ball_where_none_of_them_was(another_unit):
    unit, still, look_up = another_unit
    errors = errors_elsewhere(look_up.model, unit, still)
    assert np.median(errors) < FEW_PRESSES_TOLERANCE
    assert np.median(errors) < np.median(
        errors_elsewhere(make_built_in(load_sensor("gelsight_mini")).model, unit, still)
    )


def test_the_expected_error_is_of_the_size_of_the_error(another_unit):
    unit, still, look_up = another_unit
    measured = np.median(errors_elsewhere(look_up.model, unit, still))
    assert look_up.expected_error is not None
    assert look_up.expected_error.n_held_out == len(PLACES)
    assert measured / 4 < look_up.expected_error.diameter_share < 4 * measured


ERRORS = arrays.arrays(np.float64, (5, 4), elements=st.floats(0.001, 1.0))


@given(ERRORS, ERRORS)
def test_no_correction_is_chosen_that_is_worse_than_none(slope, diameter):
    best = choose_candidate(HeldOutErrors(slope_rms=slope, diameter_share=diameter))
    assert slope[:, best].mean() <= slope[:, 0].mean()
    worth = slope.mean(axis=0) * np.median(diameter, axis=0)
    assert worth[best] <= worth[0]


def test_diameters_that_are_right_by_luck_do_not_keep_slopes_that_are_wrong():
    slope = np.array([[0.44, 0.12]] * 4)
    diameter = np.array([[-0.03, 0.9], [0.12, 0.04], [-0.1, 0.14], [-0.2, -0.26]])
    assert choose_candidate(HeldOutErrors(slope_rms=slope, diameter_share=diameter)) == 1


def test_uninformative_presses_leave_the_built_in_table(monkeypatch):
    unit = load_sensor("gelsight_mini")
    still = optics.render_reference(unit)
    true = make_built_in(unit).model
    pictures = [press(unit, x, y, 6.31, i) for i, (x, y) in enumerate(PLACES[:2])]
    monkeypatch.setattr(
        corrections, "compute_slope_error", lambda model, _: 0.0 if model is true else 1.0
    )
    found = calibrate_balls(pictures, still, unit, 6.31)
    assert found.uses_built_in
    assert found.is_built_in
    assert found.model is true
    assert "did not improve" in found.origin


def test_a_sphere_seen_too_flat_is_said_to_be_too_large():
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(-0.5, 0.5, 9))
    true = (
        -np.stack([x.ravel(), y.ravel()], axis=1)
        / np.sqrt(1 - x.ravel() ** 2 - y.ravel() ** 2)[:, None]
    )
    assert corrections.compute_sphere_error(true, true) == pytest.approx(0.0, abs=1e-9)
    # normals' tilt halved
    flat = 0.5 * true / np.sqrt(1.0 + 0.75 * (true**2).sum(axis=1, keepdims=True))
    assert corrections.compute_sphere_error(flat, true) == pytest.approx(1.0, rel=0.02)


@given(st.integers(1, 60), st.floats(0.01, 0.9))
def test_the_fewer_presses_the_farther_better_a_correction_has_to_be(count, error):
    few = np.full(count, error)
    many = np.full(4 * count, error)
    nobody = np.zeros(0)
    assert not corrections.is_significantly_better(error, many, nobody)
    worth = error * np.exp(-2.5 / np.sqrt(count))
    assert not corrections.is_significantly_better(worth, few, nobody)
    assert corrections.is_significantly_better(worth, many, nobody)


@given(st.integers(1, 60), st.floats(0.5, 0.9), st.integers(0, 99))
def test_a_correction_that_is_better_by_luck_is_not_taken(count, share, seed):
    without = np.random.default_rng(seed).uniform(0.05, 0.2, count)
    held = share * without
    # Every press a little better is sure from five presses on, half of them worse by as much never.
    assert corrections.is_significantly_better(
        share * float(np.median(without)) - 1e-6, without, held
    ) == (count >= 5)
    half = np.concatenate([held, without])
    assert not corrections.is_significantly_better(
        0.9 * float(np.median(half)), half, np.concatenate([without, held])
    )


def test_the_error_said_of_presses_that_change_nothing_is_the_middle_one_and_steadier_for_few():
    rng = np.random.default_rng(0)
    errors = rng.normal(0.0, 0.1, (400, 4))
    middles = np.array([summarise_errors(row).diameter_share for row in errors])
    assert np.median(middles) == pytest.approx(np.median(np.abs(errors)), rel=0.1)
    assert middles.std() < 0.85 * np.median(np.abs(errors), axis=1).std()


def test_places_far_from_presses_are_not_covered():
    everywhere = [
        Circle(x_px=x, y_px=y, radius_px=20.0)
        for x in range(40, 320, 80)
        for y in range(40, 240, 80)
    ]
    change = np.zeros((240, 320, 3), np.float32)
    pressed = tuple(BallPress(index=i, change=change, circle=c) for i, c in enumerate(everywhere))
    unknown = ShadingFieldPrior(mean=np.zeros(1), precision=np.eye(1))
    known = corrections.PressSet(
        presses=pressed,
        ball=BallSlopeProfile(radius_px=50.0, sphere_slope_share=None),
        pixel_mm=0.06,
        prior=unknown,
        built_in=make_built_in(load_sensor("gelsight_mini")).model,
        seed=0,
    )
    virtual = np.full((12, 30), 0.02)
    assert compute_coverage_map(virtual, known).all()
    virtual[:, 3] = 5.0  # no ball is detected there
    assert np.flatnonzero(~compute_coverage_map(virtual, known).ravel()).tolist() == [3]
    assert not has_low_coverage(known)
    left = known.drop_presses({i for i, c in enumerate(everywhere) if c.x_px > 160})
    assert compute_coverage_map(virtual * 0, left)[:, :3].all()
    assert not compute_coverage_map(virtual * 0, left)[:, 4:].any()
    assert has_low_coverage(known.drop_presses(set(range(1, 12))))
