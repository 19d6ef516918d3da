"""How values lie on a colour scale, what is clipped, and limits that are dragged."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PyQt6.QtCore import QPoint, Qt

from pipeline.sensors.spec import load_sensor
from pipeline.views.colours import ColourScale
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import make_deviation_scale
from widgets.views.colour_bar import ColourBar, compute_histogram, fit_limits


def _scale(low=0.0, high=2.0, **sets) -> ColourScale:
    return ColourScale(
        colour_map="viridis", low=low, high=high, unit="mm", quantity="indentation", **sets
    )


@given(st.lists(st.floats(-5, 5, width=32) | st.just(float("nan")), min_size=1, max_size=60))
def test_every_known_value_is_counted_once(values):
    given_ = np.array(values, np.float32)
    spread = compute_histogram(given_, _scale())
    known = given_[np.isfinite(given_)]
    n = max(1, known.size)
    assert spread.counts.sum() == np.count_nonzero((known >= 0) & (known <= 2))
    assert spread.share_above == np.count_nonzero(known > 2) / n
    # a hundredth of the range is noise about zero
    assert spread.share_below == np.count_nonzero(known < -0.02) / n
    assert spread.share_below + spread.share_above <= 1


@pytest.fixture
def levels(qtbot):
    made = ColourBar()
    qtbot.addWidget(made)
    made.resize(204, made.sizeHint().height())
    made.show()
    return made


def test_clipping_is_told_and_drawn(levels, qtbot):
    values = np.linspace(0.0, 4.0, 10_000, dtype=np.float32).reshape(100, 100)
    levels.show_scale(_scale(), values)
    clipped = levels.grab().toImage()
    assert levels.histogram.share_above == pytest.approx(0.5, abs=0.02)
    assert "above 2 mm" in levels.toolTip()
    levels.show_scale(_scale(high=5.0), values)
    assert levels.grab().toImage() != clipped
    assert "above" not in levels.toolTip()


def test_an_end_is_dragged_on_the_scale_as_it_was(levels, qtbot):
    levels.show_scale(
        _scale(low_setting="gel_floor_mm", high_setting="gel_limit_mm"), np.ones((4, 4), np.float32)
    )
    limits: list[tuple[str, float]] = []
    levels.limit_dragged.connect(lambda name, value: limits.append((name, value)))
    qtbot.mousePress(levels, Qt.MouseButton.LeftButton, pos=QPoint(202, 25))
    for x in range(201, 101, -1):
        qtbot.mouseMove(levels, QPoint(x, 25))
    qtbot.mouseRelease(levels, Qt.MouseButton.LeftButton, pos=QPoint(102, 25))
    assert {name for name, _ in limits} == {"gel_limit_mm"}
    assert limits[-1][1] == pytest.approx(1.0, abs=0.03)
    assert len(limits) < 60  # a hundred motions


def test_both_sides_of_a_signed_scale_are_one_setting(levels, qtbot):
    scale = ColourScale(
        colour_map="diverging",
        low=-2.0,
        high=2.0,
        unit="mm",
        quantity="gap",
        low_setting="a",
        high_setting="a",
    )
    levels.show_scale(scale, np.ones((4, 4), np.float32))
    with qtbot.waitSignal(levels.limit_dragged) as signal:
        qtbot.mousePress(levels, Qt.MouseButton.LeftButton, pos=QPoint(2, 25))
        qtbot.mouseMove(levels, QPoint(52, 25))
    assert signal.args == ["a", pytest.approx(1.0, abs=0.03)]


def test_limits_that_follow_from_the_sensor_stay(levels, qtbot):
    levels.show_scale(_scale(), np.ones((4, 4), np.float32))
    with qtbot.assertNotEmitted(levels.limit_dragged, wait=80):
        qtbot.mousePress(levels, Qt.MouseButton.LeftButton, pos=QPoint(202, 25))
        qtbot.mouseMove(levels, QPoint(100, 25))
        qtbot.mouseRelease(levels, Qt.MouseButton.LeftButton, pos=QPoint(100, 25))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_fitted_limits_of_a_signed_scale_hold_both_sides(sign):
    values = sign * np.linspace(-3.0, 1.0, 10_001, dtype=np.float32)
    ((name, limit),) = fit_limits(values, _scale(-2.0, low_setting="a", high_setting="a")).items()
    assert (name, limit) == ("a", pytest.approx(2.96, abs=0.02))  # all but one per cent
    assert fit_limits(values, _scale(low_setting="a", high_setting="b"))["a"] == pytest.approx(
        -2.96 if sign > 0 else -0.96, abs=0.02
    )


def test_scales_about_zero_reach_as_far_below_as_above():
    bubble = load_sensor("soft_bubble")
    display = DisplayParams(bubble_limit_mm=7.0, residual_limit_mm=0.2)
    scale = make_deviation_scale(bubble, display)
    assert (scale.low, scale.high, scale.low_setting) == (-7.0, 7.0, scale.high_setting)
