from __future__ import annotations

import numpy as np
import pytest

from pipeline.calibration.balls import calibrate_balls
from pipeline.physics import optics
from pipeline.physics.slopes import slopes
from pipeline.sensors.spec import sensor
from pipeline.simulation.variation import varied
from pipeline.stages.depth.ball_calibration import calibrated
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
