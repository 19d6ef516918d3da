from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.calibration.balls import calibrate_balls
from pipeline.calibration.lookup import BallFit, built_in
from pipeline.physics import optics
from pipeline.physics.slopes import slopes
from pipeline.sensors.spec import sensor
from pipeline.simulation.variation import varied
from pipeline.stages.depth import ball_calibration
from pipeline.stages.depth.ball_calibration import calibrated, ended
from pipeline.stages.depth.stage import DepthParams, depth
from pipeline.values.frames import TactileFrame
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
    told = sensor("gelsight_mini")
    found = calibrated(presses(told), optics.untouched(told), told, DIAMETER_MM)
    assert found.kept_built_in
    assert found.expected is not None
    assert found.expected.n_held_out == len(PLACES)
    assert found.expected.diameter_share < STAGE_TOLERANCE
    assert found.read_as == pytest.approx(1.0, abs=STAGE_TOLERANCE)
    of_radius = calibrated(presses(told)[:2], optics.untouched(told), told, 0.5 * DIAMETER_MM)
    assert of_radius.read_as == pytest.approx(2.0, rel=0.2)


@pytest.fixture(scope="module")
def another_unit():
    unit = varied(sensor("gelsight_mini"), 11, 2.5)
    return unit, presses(unit)


def test_presses_are_asked_beside_what_the_stage_reads_not_beside_the_look_up_alone(another_unit):
    unit, pictures = another_unit
    still, told = optics.untouched(unit), sensor("gelsight_mini")
    flat = np.zeros(still.shape[:2], np.float32)
    unseen = calibrate_balls(pictures, still, told, DIAMETER_MM, read=lambda _: (flat, flat))
    assert not unseen.kept_built_in  # anything is better than to see nothing

    def exact(index):
        x, y = PLACES[index]
        return slopes(hertz(still.shape[:2], unit.pixel_mm, x, y, DIAMETER_MM, 0.6), unit.pixel_mm)

    assert calibrate_balls(pictures, still, told, DIAMETER_MM, read=exact).kept_built_in


def test_presses_in_one_corner_do_not_speak_for_the_picture(another_unit):
    unit, _ = another_unit
    still, flat = optics.untouched(unit), np.zeros(unit.camera.shape, np.float32)
    corner = [
        optics.render(unit, hertz(unit.camera.shape, unit.pixel_mm, x, y, DIAMETER_MM, 0.6), seed=x)
        for x, y in ((60, 60), (85, 70), (60, 90), (90, 95))
    ]
    found = calibrate_balls(corner, still, sensor("gelsight_mini"), DIAMETER_MM, read=lambda _: (flat, flat))
    assert found.kept_built_in
    assert "press elsewhere" in found.origin


def test_pixels_of_another_width_are_compared_in_that_width():
    told = sensor("gelsight_mini")
    pictures, still = presses(told), optics.untouched(told)
    plain, wide = (
        calibrated(pictures, still, told, DIAMETER_MM * share, pixel_mm=told.pixel_mm * share) for share in (1.0, 1.5)
    )
    assert wide.expected is not None
    assert plain.expected is not None
    assert wide.expected.diameter_share == pytest.approx(plain.expected.diameter_share, abs=0.02)


def of_presses(told=None):
    """The Mini's own look-up as if presses had made it."""
    fits = tuple(BallFit(index=i, x_px=x, y_px=y, radius_px=20.0, residual=0.1, used=True)
                 for i, (x, y) in enumerate(PLACES))  # fmt: skip
    return replace(built_in(sensor("gelsight_mini")), presses=fits, told=told)


def test_a_touch_where_no_press_tells_the_light_is_read_without():
    told = sensor("gelsight_mini")
    picture, still = presses(told)[0], optics.untouched(told)  # to the left
    frame = TactileFrame(sensor=told.name, image=picture, reference=still)
    by_presses, without = (depth(frame, told, look_up, DepthParams()) for look_up in (of_presses(), None))
    here, elsewhere = (
        depth(frame, told, of_presses(np.array([[left, not left]])), DepthParams()) for left in (True, False)
    )
    assert np.array_equal(here.indentation_mm, by_presses.indentation_mm)
    assert np.array_equal(elsewhere.indentation_mm, without.indentation_mm)
    assert not np.array_equal(here.indentation_mm, elsewhere.indentation_mm)
    assert any("no press of the calibration" in note for note in elsewhere.notes)
    assert not any("no press of the calibration" in note for note in here.notes)


@pytest.mark.parametrize(("too_wide", "share"), [(1.0, None), (1.2, 0.6), (3.0, 0.75)])
def test_contacts_that_come_out_wider_than_their_circles_end_at_more_pressure(monkeypatch, too_wide, share):
    told, shape = sensor("gelsight_mini"), (240, 320)

    def read(frame, _source, look_up, _params):  # contacts narrow down as the share grows
        wide = too_wide - (look_up.usual_share or 0.3) + 0.3
        x, y = PLACES[frame.index]
        inside = np.hypot(np.arange(shape[1]) - x, (np.arange(shape[0]) - y)[:, None]) < 20.0 * wide
        return SimpleNamespace(contact=inside)

    monkeypatch.setattr(ball_calibration, "depth", read)
    pictures = [np.zeros((*shape, 3), np.uint8)] * len(PLACES)
    assert ended(of_presses(), pictures, pictures[0], told).usual_share == share


def test_a_larger_share_of_the_usual_pressure_ends_a_contact_sooner():
    told = sensor("gelsight_mini")
    frame = TactileFrame(sensor=told.name, image=presses(told)[0], reference=optics.untouched(told))
    usual, more = (
        depth(frame, told, replace(of_presses(), usual_share=share), DepthParams()).contact for share in (None, 0.75)
    )
    assert 0.4 * usual.sum() < more.sum() < 0.95 * usual.sum()
    assert not (more & ~usual).any()
