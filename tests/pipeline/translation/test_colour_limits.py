"""Colour limits hold the touches of a recording, and what a user has set stays."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.session.sample import SAMPLE_RECORDING
from pipeline.core.params import list_settings
from pipeline.translation.colour_limits import fit_display, round_up
from pipeline.translation.translate import Request, open_translation
from pipeline.views.display_params import DisplayParams


@given(st.floats(1e-3, 1e3), st.integers(-2, 2))
def test_a_round_number_is_the_next_one_in_every_unit(peak_mm, decades):
    limit_mm = round_up(peak_mm)
    assert peak_mm <= limit_mm * (1 + 1e-6) <= 1.34 * peak_mm
    assert round_up(limit_mm) == limit_mm
    assert round_up(peak_mm * 10.0**decades) == pytest.approx(limit_mm * 10.0**decades, rel=0.34)


def test_limits_hold_the_touches_of_the_sample():
    request = Request(recording=SAMPLE_RECORDING, target="soft_bubble")
    with open_translation(request) as opened:
        fitted = fit_display(opened, DisplayParams())
        results = opened.evaluate(5, ["depth", "touch_depth"])
        for stage, limit_mm in (
            ("depth", fitted.gel_limit_mm),
            ("touch_depth", fitted.bubble_limit_mm),
        ):
            value = results[stage].output
            peak_mm = float(np.percentile(value.indentation_mm[value.contact], 99.5))
            assert 0.5 * limit_mm <= peak_mm <= limit_mm
        assert fit_display(opened, fitted) is fitted


@given(st.floats(0.1, 3.0), st.floats(1.0, 25.0))
def test_a_limit_that_is_set_is_not_fitted(gel_mm, bubble_mm):
    request = Request(recording=SAMPLE_RECORDING, target="soft_bubble")
    display = DisplayParams(gel_limit_mm=gel_mm, bubble_limit_mm=bubble_mm)
    with open_translation(request) as opened:
        assert fit_display(opened, display) is display


@pytest.mark.parametrize("target", ["soft_bubble", "gelslim", "digit"])
def test_a_fitted_limit_is_one_that_can_be_set(target):
    names = ("gel_limit_mm", "bubble_limit_mm")
    with open_translation(Request(recording=SAMPLE_RECORDING, target=target)) as opened:
        settings = list_settings(fit_display(opened, DisplayParams()))
    for value, setting in (settings[name] for name in names):
        assert setting.low <= value <= setting.high


def test_a_touch_that_cannot_be_read_leaves_the_limits_for_when_it_can(tmp_path):
    for k in range(2):  # without a reference
        image = np.random.default_rng(k).integers(60, 180, (320, 427, 3), dtype=np.uint8)
        cv2.imwrite(str(tmp_path / f"touch_{k}.png"), image)
    request = Request(recording=tmp_path, source="gelslim", target="soft_bubble")
    display = DisplayParams()
    with open_translation(request) as opened:
        assert fit_display(opened, display, strongest=0) is display
