from __future__ import annotations

from dataclasses import replace

import pytest

from pipeline.base.stage_warnings import StageWarning
from pipeline.calibration import quality_notes
from pipeline.calibration.calibration_table import BallFit, ExpectedError, make_built_in
from pipeline.calibration.quality_notes import UNCALIBRATED
from pipeline.sensors.spec import load_sensor

PRESS = BallFit(index=0, x_px=10.0, y_px=20.0, radius_px=15.0, residual=0.02, used=True)
ERROR = ExpectedError(diameter_share=0.083, depth_share=0.071, n_held_out=4)


@pytest.fixture
def look_up():
    return make_built_in(load_sensor("gelsight_mini"))


def test_a_look_up_without_presses_is_called_uncalibrated_and_what_to_do_is_said(look_up):
    note = quality_notes.describe_quality(look_up)
    assert note.startswith(UNCALIBRATED)
    assert "calibrate balls" in note
    assert any("uncalibrated" in line for line in quality_notes.format_calibration(look_up))


def test_presses_that_look_like_a_ball_of_another_size_speak_against_the_size_that_was_given(look_up):
    known = replace(look_up, presses=(PRESS,) * 4, expected_error=ERROR)
    for ratio, odd in ((None, False), (0.7, False), (1.5, False), (2.0, True), (0.5, True)):
        told = replace(known, diameter_ratio=ratio)
        assert isinstance(quality_notes.describe_quality(told), StageWarning) is odd
        assert any("times the given diameter" in line for line in quality_notes.format_calibration(told)) is odd


def test_a_look_up_that_presses_did_not_better_is_called_uncalibrated(look_up):
    note = quality_notes.describe_quality(replace(look_up, presses=(PRESS,), uses_built_in=True, expected_error=ERROR))
    assert note.startswith(UNCALIBRATED)
    assert "did not improve" in note


def test_a_calibrated_look_up_says_what_error_to_expect_and_on_what_that_rests(look_up):
    known = replace(look_up, presses=(PRESS,) * 4, expected_error=ERROR)
    assert quality_notes.describe_quality(known) == "a ball's diameter within 8 %: calibrated by 4 presses of a ball"
    told = " ".join(quality_notes.format_calibration(known))
    assert "diameter 8 %" in told
    assert "depth 7 %" in told
    assert "4 held-out presses" in told


def test_an_error_that_no_press_was_held_out_for_is_called_foreseen(look_up):
    known = replace(look_up, presses=(PRESS,), expected_error=replace(ERROR, n_held_out=0))
    assert "predicted" in quality_notes.describe_expected_error(known)
