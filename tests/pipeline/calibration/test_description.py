from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration import quality_notes
from pipeline.calibration.calibration_table import BallFit, ExpectedError, make_built_in
from pipeline.calibration.quality_notes import UNCALIBRATED
from pipeline.core.errors import StageWarning
from pipeline.sensors.spec import load_sensor

PRESS = BallFit(index=0, x_px=10.0, y_px=20.0, radius_px=15.0, residual=0.02, used=True)
ERROR = ExpectedError(
    diameter_share=0.083, diameter_p90=0.19, depth_share=0.071, depth_p90=0.16, n_held_out=4
)


@pytest.fixture
def table():
    return make_built_in(load_sensor("gelsight_mini"))


def test_a_calibration_without_presses_is_called_uncalibrated_with_a_remedy(table):
    note = quality_notes.describe_quality(table)
    assert note.startswith(UNCALIBRATED)
    assert "calibrate balls" in note
    assert any(UNCALIBRATED in line for line in quality_notes.format_calibration(table))


def test_presses_that_look_like_another_size_give_a_warning(table):
    known = replace(table, presses=(PRESS,) * 4, expected_error=ERROR)
    for ratio, odd in ((None, False), (0.8, False), (1.3, False), (1.5, True), (0.5, True)):
        report = replace(known, diameter_ratio=ratio)
        assert isinstance(quality_notes.describe_quality(report), StageWarning) is odd
        assert (
            any(
                "times the given diameter" in line
                for line in quality_notes.format_calibration(report)
            )
            is odd
        )
    wide = replace(known, pixel_mm=0.105, diameter_ratio=1.5)
    assert "0.07 mm would fit" in quality_notes.describe_size_mismatch(wide)


def test_a_table_that_presses_did_not_improve_is_called_uncalibrated(table):
    note = quality_notes.describe_quality(
        replace(table, presses=(PRESS,), uses_built_in=True, expected_error=ERROR)
    )
    assert note.startswith(UNCALIBRATED)
    assert "did not improve" in note


def test_a_calibration_states_the_error_of_nine_of_ten_touches_and_its_basis(table):
    known = replace(table, presses=(PRESS,) * 4, expected_error=ERROR)
    assert "within 19 %" in quality_notes.describe_quality(known)
    scaled = replace(known, uses_built_in=True, depth_scale_map=np.ones((2, 2), np.float32))
    assert "depth scaled by 4 presses" in quality_notes.describe_quality(scaled)
    report = " ".join(quality_notes.format_calibration(known))
    assert "diameter: up to 19 %" in report
    assert "median 8 %" in report
    assert "depth 16 %" in report
    assert "4 held-out presses" in report
