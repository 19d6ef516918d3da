from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.calibration import slope_model
from pipeline.calibration.ball_presses import BallPress, BallSlopeProfile, sample_contact
from pipeline.calibration.balls import (
    PressSet,
    compute_coverage_map,
    cross_validate,
    find_presses,
    fit_table,
    measure_diameter_error,
    summarise_errors,
)
from pipeline.calibration.calibration_table import compute_relative_change, make_built_in
from pipeline.calibration.contact_circles import Circle
from pipeline.calibration.shading_field import ShadingFieldPrior
from pipeline.core.progress import SILENT
from pipeline.physics import optics
from pipeline.physics.simulation.variation import vary_sensor
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.ball_calibration import is_significantly_better
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
    """A unit unlike the description, its still picture, and four presses of it."""
    unit = vary_sensor(load_sensor("gelsight_mini"), 11, 2.5)
    still = optics.render_reference(unit)
    pictures = [press(unit, x, y, 6.31, i) for i, (x, y) in enumerate(PLACES)]
    mini = load_sensor("gelsight_mini")
    known = find_presses(pictures, still, mini, 6.31, pixel_mm=mini.pixel_mm, progress=SILENT)
    return unit, still, known


def errors_elsewhere(model, unit, still):
    found = []
    for k, (x, y) in enumerate(ELSEWHERE):
        change = compute_relative_change(press(unit, x, y, 9.5, 30 + k), still, unit.pixel_mm)
        radius_px = np.sqrt(4.75 * 0.6) / unit.pixel_mm
        seen = BallPress(index=0, change=change, circle=Circle(x_px=x, y_px=y, radius_px=radius_px))
        ball = BallSlopeProfile(radius_px=4.75 / unit.pixel_mm)
        samples = sample_contact(seen, ball)
        found.append(abs(measure_diameter_error(slope_model.predict(model, samples), samples)))
    return np.array(found)


def test_four_presses_measure_another_ball_where_none_of_them_was(another_unit):
    unit, still, known = another_unit
    errors = errors_elsewhere(fit_table(known), unit, still)
    assert np.median(errors) < FEW_PRESSES_TOLERANCE
    described = errors_elsewhere(make_built_in(load_sensor("gelsight_mini")).model, unit, still)
    assert errors.mean() < 0.9 * described.mean()


def test_the_expected_error_is_of_the_size_of_the_error(another_unit):
    unit, still, known = another_unit
    measured = np.median(errors_elsewhere(fit_table(known), unit, still))
    expected = summarise_errors(cross_validate(known, lambda _: None))
    assert expected.n_held_out == len(PLACES)
    assert measured / 4 < expected.diameter_share < 4 * measured


def test_a_sphere_seen_too_flat_is_said_to_be_too_large():
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(-0.5, 0.5, 9))
    true = (
        -np.stack([x.ravel(), y.ravel()], axis=1)
        / np.sqrt(1 - x.ravel() ** 2 - y.ravel() ** 2)[:, None]
    )
    nowhere = np.zeros(len(true), np.float32)
    samples = slope_model.SlopeSamples(
        change=np.zeros((len(true), 3), np.float32), u=nowhere, v=nowhere, slopes=true
    )
    assert measure_diameter_error(true, samples) == pytest.approx(0.0, abs=1e-9)
    # normals' tilt halved
    flat = 0.5 * true / np.sqrt(1.0 + 0.75 * (true**2).sum(axis=1, keepdims=True))
    assert measure_diameter_error(flat, samples) == pytest.approx(1.0, rel=0.02)


@given(st.integers(2, 60), st.floats(0.5, 0.9), st.integers(0, 99))
def test_a_table_that_is_better_by_luck_is_not_taken(count, share, seed):
    without = np.random.default_rng(seed).uniform(0.05, 0.2, count)
    held = share * without
    luck = np.concatenate([held, without]), np.concatenate([without, held])
    assert not is_significantly_better(*luck)
    assert not is_significantly_better(without, held)
    assert is_significantly_better(held, without) == (count >= 6)
    assert not is_significantly_better(without, without)
    assert not is_significantly_better(np.full(count, np.nan), without)  # detects no ball


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
    known = PressSet(
        presses=tuple(
            BallPress(index=i, change=change, circle=c) for i, c in enumerate(everywhere)
        ),
        ball=BallSlopeProfile(radius_px=50.0),
        pixel_mm=0.06,
        prior=ShadingFieldPrior(mean=np.zeros(1), precision=np.eye(1)),
    )
    assert compute_coverage_map(known).all()
    left = known.drop_presses({i for i, c in enumerate(everywhere) if c.x_px > 160})
    assert compute_coverage_map(left)[:, :6].all()
    assert not compute_coverage_map(left)[:, 10:].any()
    assert compute_coverage_map(known.drop_presses(set(range(1, 12)))).mean() < 0.5
