"""The timeline chooses frames and waits for them."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtWidgets import QLabel

from widgets.timeline.timeline import FRAMES_PER_SECOND, SPEEDS, Timeline


@pytest.fixture
def line(qtbot):
    made = Timeline()
    qtbot.addWidget(made)
    made.show_frames(10)
    yield made
    made.play(on=False)


def test_moving_the_slider_chooses_a_frame(line, qtbot):
    with qtbot.waitSignal(line.frame_chosen) as signal:
        line.slider.setValue(4)
    assert signal.args == [4]
    assert line.number.value() == 4


def test_showing_a_frame_says_nothing(line, qtbot):
    with qtbot.assertNotEmitted(line.frame_chosen):
        line.show_frame(7, 1.5)
    assert line.slider.value() == 7


def test_steps_stop_at_both_ends(line):
    line.step_to(line.frame - 3)
    assert line.frame == 0
    line.step_to(line.frame + 100)
    assert line.frame == 9


def test_playing_goes_through_the_frames_and_stops(line, qtbot):
    seen: list[int] = []
    line.frame_chosen.connect(seen.append)
    line.speed.setCurrentIndex(SPEEDS.index(4.0))
    with qtbot.waitSignal(line.play_toggled, check_params_cb=lambda on: not on, timeout=240_000):
        line.play(on=True)
    assert seen == sorted(seen)
    assert seen[-1] == 9


def test_playing_waits_for_a_frame_that_is_not_shown_yet(line, qtbot):
    seen: list[int] = []
    line.show_ready(ready=False)
    line.frame_chosen.connect(seen.append)
    line.play(on=True)
    line._tick()  # a tick's worth of time is a fact of the clock, not of the test
    for _ in range(20):
        line._tick()
    assert seen == []
    line.show_ready(ready=True)
    qtbot.waitUntil(lambda: bool(seen), timeout=2000)


@pytest.mark.parametrize("late_s", [0.01, 0.034, 0.07])
def test_late_ticks_do_not_slow_playing_down(line, monkeypatch, late_s):
    """Frames are due by the clock: ticks come late where the window has work to do."""
    now = [100.0]
    monkeypatch.setattr("widgets.timeline.timeline.time.monotonic", lambda: now[0])
    line.show_frames(1000)
    seen: list[int] = []
    line.frame_chosen.connect(seen.append)
    line.play(on=True)
    while now[0] < 130.0:
        now[0] += late_s
        line._tick()
    assert abs(len(seen) - 30 * FRAMES_PER_SECOND) <= 2
    assert seen == list(range(1, len(seen) + 1))


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0])
def test_the_next_look_is_when_a_frame_is_due(line, monkeypatch, speed):
    """The clock is set for the moment: a run ends as many periods after its beginning as there
    are frames between.
    """
    now = [100.0]
    chosen_s = []
    monkeypatch.setattr("widgets.timeline.timeline.time.monotonic", lambda: now[0])
    line.show_frames(40)
    line.speed.setCurrentIndex(SPEEDS.index(speed))
    line.frame_chosen.connect(lambda _: chosen_s.append(now[0]))
    line.play(on=True)
    while line.is_playing:
        now[0] += line._clock.interval() * 1e-3
        line._tick()
    gaps = np.diff(chosen_s)
    period_s = 1.0 / (FRAMES_PER_SECOND * speed)
    assert len(chosen_s) == 39
    assert np.abs(gaps - period_s).max() < 0.0021
    assert np.mean(gaps) == pytest.approx(period_s, rel=1e-3)


def test_frames_that_are_left_out_are_told(line, monkeypatch):
    now = [100.0]
    seen = []
    monkeypatch.setattr("widgets.timeline.timeline.time.monotonic", lambda: now[0])
    left_out_label = line.findChild(QLabel, "left_out")
    line.show_frames(1000)
    line.frame_chosen.connect(seen.append)
    line.play(on=True)
    for _ in range(12):
        line.show_ready(ready=False)
        now[0] += 0.3  # each takes three periods to be worked out
        line._tick()
        line.show_ready(ready=True)
        line._tick()
    assert seen[:3] == [3, 6, 9]
    assert left_out_label.text() == "8 of 24 shown"
    for _ in range(8):
        now[0] += 0.1
        line._tick()
    assert left_out_label.text() == "", "it keeps up again"
    line.play(on=False)
    assert left_out_label.text() == ""


def test_a_late_frame_is_followed_as_soon_as_it_is_there(line, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("widgets.timeline.timeline.time.monotonic", lambda: now[0])
    line.play(on=True)
    line.show_ready(ready=False)
    now[0] += 0.15
    line._tick()
    assert line.frame == 0
    line.show_ready(ready=True)
    assert line._clock.interval() == 0
    assert line.frame == 0, "not from within what shows the last one"


def test_a_loop_begins_again(line, qtbot):
    line.set_looping(looping=True)
    line.show_frame(9)
    seen: list[int] = []
    line.frame_chosen.connect(seen.append)
    line._clock.start()
    qtbot.waitUntil(lambda: bool(seen), timeout=240_000)
    assert seen[0] < 9
    assert line.is_playing


def test_one_frame_cannot_be_played(line):
    line.show_frames(1)
    line.play(on=True)
    assert not line.is_playing


def test_a_loop_stays_within_its_frames(line, qtbot):
    seen: list[int] = []
    line.set_looping(True)
    line.set_loop_range(5, 3)  # the wrong way round means the same
    assert line.errors.loop_range == (3, 5)
    line.frame_chosen.connect(seen.append)
    line.speed.setCurrentIndex(SPEEDS.index(4.0))
    line.play(on=True)
    qtbot.waitUntil(lambda: len(seen) >= 7, timeout=240_000)
    line.play(on=False)
    assert seen[0] == 3  # from outside it goes to the beginning
    assert set(seen) <= {3, 4, 5}
    assert seen.count(3) > 1
    line.show_frames(12)  # a recording that grows keeps it
    assert line.loop_range == (3, 5)
    line.show_frames(4)
    assert line.loop_range == (0, 3)
    assert line.errors.loop_range is None


def test_the_bars_have_a_scale_from_nothing_to_the_worst(line):
    line.show_errors("touch depth: error in contact, mm", [0.1, np.nan, 0.3987], {})
    line.show()
    line.resize(900, 60)
    assert line.scale.max_text == "0.399"
    pixels = line.scale.grab().toImage()
    assert (
        len({pixels.pixel(x, y) for x in range(pixels.width()) for y in range(pixels.height())}) > 2
    )
    line.show_errors("touch depth: error in contact, mm", [np.nan, np.nan, np.nan], {})
    assert line.scale.max_text == ""
