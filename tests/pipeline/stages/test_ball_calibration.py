from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.calibration import near_led_prior
from pipeline.calibration.ball_presses import BallPress, BallSlopeProfile
from pipeline.calibration.balls import PressSet, find_presses, summarise_errors
from pipeline.calibration.calibration_table import BallFit, make_built_in
from pipeline.calibration.contact_circles import Circle
from pipeline.calibration.shading_field import ShadingFieldPrior
from pipeline.core.progress import SILENT
from pipeline.core.values.frames import TactileFrame
from pipeline.physics import optics
from pipeline.physics.simulation.variation import vary_sensor
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth import ball_calibration
from pipeline.stages.depth.ball_calibration import (
    add_depth_scale,
    calibrate_sensor,
    replace_table,
)
from pipeline.stages.depth.gel.result import NOT_SCALED
from pipeline.stages.depth.illumination import selection
from pipeline.stages.depth.illumination.light import Illumination
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from tests.pipeline.calibration.test_balls import hertz

DIAMETER_MM = 6.31
PLACES = [(90, 70), (230, 80), (110, 170), (220, 165)]
STAGE_TOLERANCE = 0.1  # of the diameter: what the stage reads on a unit that is as it is described


def presses(unit):
    return [
        optics.render(unit, hertz(unit.camera.shape, unit.pixel_mm, x, y, DIAMETER_MM, 0.6), seed=i)
        for i, (x, y) in enumerate(PLACES)
    ]


def test_presses_of_a_unit_that_is_read_well_without_them_change_nothing():
    mini = load_sensor("gelsight_mini")
    found = calibrate_sensor(presses(mini), optics.render_reference(mini), mini, DIAMETER_MM)
    assert found.uses_built_in
    assert found.expected_error is not None
    assert found.expected_error.n_held_out == len(PLACES)
    assert found.expected_error.diameter_share < STAGE_TOLERANCE
    assert found.diameter_ratio == pytest.approx(1.0, abs=STAGE_TOLERANCE)
    of_radius = calibrate_sensor(
        presses(mini)[:2], optics.render_reference(mini), mini, 0.5 * DIAMETER_MM
    )
    assert of_radius.diameter_ratio == pytest.approx(2.0, rel=0.2)


@pytest.fixture(scope="module")
def another_unit():
    unit = vary_sensor(load_sensor("gelsight_mini"), 11, 2.5)
    return unit, presses(unit)


def find(pictures, still):
    mini = load_sensor("gelsight_mini")
    return find_presses(pictures, still, mini, DIAMETER_MM, pixel_mm=mini.pixel_mm, progress=SILENT)


def test_the_errors_that_a_table_has_to_beat_are_those_of_the_depth_stage(another_unit):
    unit, pictures = another_unit
    known = find(pictures, optics.render_reference(unit))
    nothing_seen = np.full(6, np.nan)
    held = np.full(6, 0.05)
    table = replace_table(of_presses(), known, nothing_seen, held)
    assert table is not None
    assert not table.is_built_in
    assert table.expected_error.diameter_share == pytest.approx(0.05, rel=0.2)
    assert replace_table(of_presses(), known, held, held) is None


def test_presses_in_one_corner_give_no_table(another_unit):
    unit, _ = another_unit
    corner = [
        optics.render(unit, hertz(unit.camera.shape, unit.pixel_mm, x, y, DIAMETER_MM, 0.6), seed=x)
        for x, y in ((60, 60), (85, 70), (60, 90), (90, 95))
    ]
    known = find(corner, optics.render_reference(unit))
    assert replace_table(of_presses(), known, np.full(6, np.nan), np.full(6, 0.05)) is None


def test_pixels_of_another_width_are_compared_in_that_width():
    mini = load_sensor("gelsight_mini")
    pictures = presses(mini)
    still = optics.render_reference(mini)
    plain, wide = (
        calibrate_sensor(pictures, still, mini, DIAMETER_MM * share, pixel_mm=mini.pixel_mm * share)
        for share in (1.0, 1.5)
    )
    assert wide.expected_error is not None
    assert plain.expected_error is not None
    assert wide.expected_error.diameter_share == pytest.approx(
        plain.expected_error.diameter_share, abs=0.02
    )


def of_presses(coverage_map=None):
    """The Mini's own look-up as if presses had made it."""
    fits = tuple(
        BallFit(index=i, x_px=x, y_px=y, radius_px=20.0, residual=0.1, used=True)
        for i, (x, y) in enumerate(PLACES)
    )
    return replace(
        make_built_in(load_sensor("gelsight_mini")), presses=fits, coverage_map=coverage_map
    )


def test_a_touch_that_no_press_covers_is_estimated_without_calibration():
    mini = load_sensor("gelsight_mini")
    # to the left
    picture = presses(mini)[0]
    still = optics.render_reference(mini)
    frame = TactileFrame(sensor=mini.name, image=picture, reference=still)
    by_presses, without = (
        estimate_depth(frame, mini, look_up, DepthParams()) for look_up in (of_presses(), None)
    )
    here, elsewhere = (
        estimate_depth(frame, mini, of_presses(np.array([[left, not left]])), DepthParams())
        for left in (True, False)
    )
    assert np.array_equal(here.indentation_mm, by_presses.indentation_mm)
    assert np.array_equal(elsewhere.indentation_mm, without.indentation_mm)
    assert not np.array_equal(here.indentation_mm, elsewhere.indentation_mm)
    assert any("no indentation of the calibration" in note for note in elsewhere.notes)
    assert not any("no indentation of the calibration" in note for note in here.notes)


@pytest.mark.parametrize(("model", "factor"), [("described", 1.3), ("near", 1.3), ("field", 1.0)])
def test_depth_is_scaled_by_places_where_the_light_is_not_fitted_to_the_touch_itself(
    monkeypatch, model, factor
):
    described = load_sensor("gelsight_mini")
    prior = near_led_prior.compute_prior(described, described.pixel_mm, described.camera.shape)
    light = Illumination(model=model, parameters=tuple(prior.mean) if model == "field" else ())
    monkeypatch.setattr(selection, "choose_illumination", lambda *_: light)
    frame = TactileFrame(
        sensor=described.name,
        image=presses(described)[0],
        reference=optics.render_reference(described),
    )
    table = make_built_in(described)
    scaled = replace(table, depth_scale_map=np.full((2, 2), 1.3, np.float32))
    plain, more = (estimate_depth(frame, described, one, DepthParams()) for one in (table, scaled))
    inside = plain.contact & more.contact
    assert inside.sum() > 100
    assert more.indentation_mm[inside].sum() == pytest.approx(
        factor * plain.indentation_mm[inside].sum(), rel=0.03
    )
    is_scaled = factor != 1.0
    assert (NOT_SCALED in more.notes) is not is_scaled
    known = replace(
        scaled,
        presses=of_presses().presses,
        uses_built_in=True,
        expected_error=of_presses().expected_error,
    )
    promised = estimate_depth(frame, described, known, DepthParams()).notes[0]
    assert ("depth scaled by" in promised) is is_scaled
    assert promised.startswith("sensor not calibrated") is not is_scaled


def at_places(shape):
    """Presses whose circles are known."""
    change = np.zeros((*shape, 3), np.float32)
    return PressSet(
        presses=tuple(
            BallPress(index=i, change=change, circle=Circle(x_px=x, y_px=y, radius_px=20.0))
            for i, (x, y) in enumerate(PLACES)
        ),
        ball=BallSlopeProfile(radius_px=50.0),
        pixel_mm=0.06,
        prior=ShadingFieldPrior(mean=np.zeros(1), precision=np.eye(1)),
    )


def test_presses_scale_depth_by_how_far_they_are_off_and_state_what_is_left():
    without = replace(of_presses(), uses_built_in=True)
    known = at_places((240, 320))
    off = np.full(len(PLACES), 1.25)
    scaled = add_depth_scale(without, known, off, off)
    assert scaled.is_built_in
    assert 1.15 < scaled.depth_scale_map.mean() < 1.25
    assert scaled.expected_error.n_held_out == len(PLACES)
    assert scaled.expected_error.diameter_share < scaled.expected_error.diameter_p90 < 0.25
    assert add_depth_scale(without, known, off, np.full(len(PLACES), np.nan)) is None
    most = add_depth_scale(without, known, off, np.where(np.arange(len(PLACES)) > 0, off, np.nan))
    assert most.expected_error.n_held_out == len(PLACES)
    assert most.expected_error.diameter_share > scaled.expected_error.diameter_share
    half = np.where(np.arange(len(PLACES)) % 2 == 0, off, np.nan)
    assert add_depth_scale(without, known, off, half) is None  # half would not be scaled
    # a pixel width thrice the true one: more than a scale is trusted with
    wrong = np.full(len(PLACES), 3.0)
    assert add_depth_scale(without, known, wrong, wrong).expected_error.diameter_share > 0.5


@pytest.mark.parametrize(
    ("off", "scaled_error", "table_error", "taken"),
    [
        (1.1, 0.01, 0.3, "scale"),
        (1.1, 0.01, 0.001, "table"),
        (1.1, 0.3, 0.25, "description"),
        (1.5, 0.27, 0.11, "table"),  # a pixel width half as large again: the scale predicts 3 %
    ],
)
def test_the_calibration_that_measures_its_own_presses_best_is_taken(
    monkeypatch, off, scaled_error, table_error, taken
):
    described = load_sensor("gelsight_mini")
    shape = described.camera.shape

    def read(frame, _sensor, used, _params):
        x, y = PLACES[frame.index]
        inside = (
            np.hypot(np.arange(shape[1]) - x, (np.arange(shape[0]) - y)[:, None])
            * described.pixel_mm
            < 1.2
        )
        ratio = off if used.is_built_in else 1.0 + table_error
        ratio = ratio if used.depth_scale_map is None else 1.0 + scaled_error
        depth_mm = hertz(shape, described.pixel_mm, x, y, ratio * DIAMETER_MM, 0.6)
        light = SimpleNamespace(is_bound_to_place=True)
        return SimpleNamespace(indentation_mm=depth_mm, contact=inside), light

    table = replace(of_presses(), expected_error=summarise_errors(np.full(4, 1e-3)))
    monkeypatch.setattr(ball_calibration, "estimate_gel_depth", read)
    monkeypatch.setattr(ball_calibration, "find_presses", lambda *_, **__: at_places(shape))
    monkeypatch.setattr(ball_calibration, "list_fits", lambda *_: of_presses().presses)
    monkeypatch.setattr(ball_calibration, "cross_validate", lambda *_: np.zeros(4))
    monkeypatch.setattr(ball_calibration, "replace_table", lambda *_: table)
    images = [np.zeros((*shape, 3), np.uint8)] * len(PLACES)
    found = calibrate_sensor(images, images[0], described, DIAMETER_MM)
    assert ("description" if found.is_built_in else "table") == {"scale": "description"}.get(
        taken, taken
    )
    assert (found.depth_scale_map is not None) is (taken == "scale")
    if taken == "scale":  # under a ball the gel is a paraboloid here
        assert found.diameter_ratio == pytest.approx(off, abs=0.07)
