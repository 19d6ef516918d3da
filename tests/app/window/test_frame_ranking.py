"""The table of frames fills by itself while it is seen, and leads to the worst."""

from __future__ import annotations

import math

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtWidgets import QLabel
from scipy import stats

from app.session.sample import SAMPLE_RECORDING
from app.session.state import Session, load_session
from app.shell.tour import wait_until_shown
from pipeline.calibration.force_scale import fit_force_scale, save_force_scale
from pipeline.stages.metrics.stage_metrics import UNCALIBRATED_FORCE, UNCALIBRATED_SHEAR
from widgets.frames.frame_summary import FrameSummary
from widgets.frames.frames_model import CAUSE, FRAME, METRIC, NOTE, WARNINGS
from widgets.frames.frames_panel import FramesPanel

pytestmark = pytest.mark.ranks_frames
PAIRED = SAMPLE_RECORDING.with_name("digit_gelslim.h5")
TOUCHED = 3  # a frame that both sensors feel, of six
LIMIT_MS = 240_000
_UP = Qt.SortOrder.AscendingOrder
_DOWN = Qt.SortOrder.DescendingOrder


@pytest.fixture
def window(open_window):
    controller = open_window(PAIRED, source="digit", target="gelslim", frame=TOUCHED)
    assert wait_until_shown(controller, 240), controller.window.banner.text
    return controller


def test_every_frame_with_truth_is_ranked_and_one_key_shows_the_worst(window, qtbot):
    panel = window.window.frames
    known = panel.model
    qtbot.waitUntil(lambda: known.find_unknown_frame(TOUCHED) < 0, timeout=LIMIT_MS)
    assert window.session.frame == TOUCHED
    figures = {
        f: known.get_summary(f).metrics.get("touch_depth.contact_mae_mm", math.nan)
        for f in range(known.rowCount())
    }
    ranked = sorted(
        (f for f, v in figures.items() if math.isfinite(v)), key=figures.__getitem__, reverse=True
    )
    line = window.window.timeline.errors
    # nobody opened the table
    qtbot.waitUntil(lambda: line.worst_frame == ranked[0], timeout=LIMIT_MS)
    assert "touch depth: error in contact, mm" in [
        label.text() for label in window.window.timeline.findChildren(QLabel)
    ]
    wanted = [figures[f] for f in range(known.rowCount())]
    qtbot.waitUntil(lambda: np.array_equal(line.values, wanted, equal_nan=True), timeout=LIMIT_MS)
    assert (
        set(line.warnings)
        == {f for f in range(known.rowCount()) if known.get_specific_warnings(f)}
        != set()
    )
    window.window.actions_by_name["worst_frame"].trigger()
    assert window.session.frame == ranked[0]
    window.choose_frame(0)  # untouched: it has no error, so the worst of all comes first
    assert wait_until_shown(window, 240)
    window.window.actions_by_name["worse_frame"].trigger()
    assert window.session.frame == ranked[0]
    window.window.actions_by_name["better_frame"].trigger()
    assert window.session.frame == ranked[1]
    assert wait_until_shown(window, 240)
    assert window.latest_frame.index == ranked[1]


def test_force_of_every_frame_is_a_curve_that_takes_their_depth_alone(window, qtbot, tmp_path):
    panel = window.window.frames
    line = window.window.timeline.errors
    assert panel.metric_box.findData(UNCALIBRATED_FORCE) >= 0
    panel.metric_box.chosen.emit(UNCALIBRATED_FORCE)
    qtbot.waitUntil(
        lambda: panel.model.find_unknown_frame(0, quantity=UNCALIBRATED_FORCE) < 0, timeout=LIMIT_MS
    )
    qtbot.waitUntil(lambda: bool(np.isfinite(line.values).all()), timeout=LIMIT_MS)
    assert line.is_curve
    assert (
        panel.model.find_unknown_frame(TOUCHED) >= 0
    )  # frames whose whole translation nobody needed
    stream = window.views.translation.stream
    true = [-stream.truth(i).force_n[2] for i in range(len(line.values))]
    assert line.values[0] == true[0] == 0.0
    assert stats.spearmanr(line.values, true)[0] > 0.9
    assert "force (scale unknown), N" in [
        label.text() for label in window.window.timeline.findChildren(QLabel)
    ]
    before = np.array(line.values)
    calibration = tmp_path / "force.npz"
    save_force_scale(fit_force_scale("digit", [1.0, 4.0], [2.0, 8.0]), calibration)
    window.change("calibration", calibration=calibration)
    labels = window.window.timeline.findChildren(QLabel)
    qtbot.waitUntil(lambda: "force, N" in [label.text() for label in labels], timeout=LIMIT_MS)
    qtbot.waitUntil(lambda: bool(np.isfinite(line.values).all()), timeout=LIMIT_MS)
    np.testing.assert_allclose(line.values, 2.0 * before, rtol=1e-6)


def test_shear_of_every_frame_of_a_marked_gel_is_a_curve(open_window, qtbot):
    controller = open_window(PAIRED, source="gelslim", target="digit", frame=TOUCHED)
    assert wait_until_shown(controller, 240), controller.window.banner.text
    panel = controller.window.frames
    line = controller.window.timeline.errors
    panel.metric_box.chosen.emit(UNCALIBRATED_SHEAR)
    qtbot.waitUntil(
        lambda: panel.model.find_unknown_frame(0, quantity=UNCALIBRATED_SHEAR) < 0, timeout=LIMIT_MS
    )
    qtbot.waitUntil(lambda: bool(np.isfinite(line.values).all()), timeout=LIMIT_MS)
    assert line.values[0] == 0.0  # untouched
    force_n = [
        -controller.views.translation.stream.truth(i).force_n[2] for i in range(len(line.values))
    ]
    assert max(line.values) < 0.05 * max(force_n)  # the sample is pressed and turned, not dragged


def test_a_click_in_the_timeline_chooses_the_frame(window, qtbot):
    line = window.window.timeline.errors
    n = window.views.translation.n_frames
    qtbot.waitUntil(lambda: len(line.values) == n, timeout=LIMIT_MS)
    places = [line.frame_at(x) for x in range(line.width())]
    assert sorted(set(places)) == list(range(n))
    qtbot.mouseClick(line, Qt.MouseButton.LeftButton, pos=QPoint(places.index(2) + 3, 10))
    assert window.session.frame == 2


def test_a_recording_without_truth_fills_the_strip_by_its_round_trip(bubble_window, qtbot):
    controller = bubble_window
    assert not controller.views.translation.stream.has_truth
    line = controller.window.timeline.errors
    panel = controller.window.frames
    touched = controller.session.frame
    qtbot.waitUntil(
        lambda: touched < len(line.values) and math.isfinite(line.values[touched]), timeout=LIMIT_MS
    )
    assert line.worst_frame >= 0  # nobody opened the table
    texts = [label.text() for label in controller.window.timeline.findChildren(QLabel)]
    assert "round-trip error, mm" in texts
    summary = panel.model.get_summary(touched)
    assert summary.metrics["frame.round_trip_mm"] == line.values[touched] > 0
    assert summary.metrics["frame.training_distance"] > 0
    names = [panel.metric_box.itemText(i) for i in range(panel.metric_box.count())]
    assert {
        "round-trip error, mm",
        "distance from training",
        "warnings",
        "contact area, mm²",
    } <= set(names)


def test_a_row_has_a_thumbnail_and_the_cause_of_its_error(qtbot, monkeypatch):
    panel = FramesPanel()
    qtbot.addWidget(panel)
    model = panel.model
    model.reset_frames(3)
    image = np.full((30, 40, 3), 200, np.uint8)
    touched = {"max_indentation_mm": 0.2, "contact_area_mm2": 3.0}
    model.show_summary(
        0,
        FrameSummary(
            **touched, warnings=("depth: saturated",), thumbnail=image, dark_thumbnail=image // 4
        ),
    )
    model.show_summary(1, FrameSummary(**touched))
    assert model.find_unknown_frame(0, completely=True) == 0
    figures = {"frame.round_trip_mm": 0.04}
    model.show_summary(0, FrameSummary(**touched, metrics=figures, cause="depth", is_complete=True))
    assert model.find_unknown_frame(0, completely=True) == 1
    model.show_summary(
        0, FrameSummary(**touched, warnings=("depth: saturated",))
    )  # shown again: keeps what took longer
    model.show_metric("frame.round_trip_mm", "error")
    cells = [model.data(model.index(0, column)) for column in (METRIC, CAUSE, WARNINGS)]
    assert cells == ["0.040", "depth", "1"]
    monkeypatch.setattr("widgets.frames.frames_model.is_dark", lambda _palette: False)
    pixmap = model.data(model.index(0, FRAME), Qt.ItemDataRole.DecorationRole).pixmap(40, 30)
    assert (pixmap.width(), pixmap.height()) == (40, 30)
    assert model.thumbnails.keys() == {0}
    monkeypatch.setattr("widgets.frames.frames_model.is_dark", lambda _palette: True)
    dark = model.data(model.index(0, FRAME), Qt.ItemDataRole.DecorationRole).pixmap(40, 30)
    assert dark.toImage().pixelColor(0, 0).red() < 100 < pixmap.toImage().pixelColor(0, 0).red()
    assert model.get_values("frame.n_warnings")[:2] == (1.0, 0.0)
    assert model.get_values("frame.contact_area_mm2")[0] == 3.0
    header = panel.table.horizontalHeader()
    text_px = panel.table.fontMetrics().horizontalAdvance("0.040")
    assert header.visualIndex(METRIC) == 1
    assert header.sectionSize(METRIC) > text_px


def test_the_chosen_metric_ranks_the_frames(qtbot):
    panel = FramesPanel()
    qtbot.addWidget(panel)
    panel.model.reset_frames(4)
    for frame, (a, b) in enumerate(((0.1, 30.0), (0.4, 20.0), (0.2, 40.0))):
        figures = {"a.mae_mm": a, "b.psnr_db": b}
        panel.model.show_summary(
            frame, FrameSummary(max_indentation_mm=0.2, contact_area_mm2=3.0, metrics=figures)
        )
    chosen = []
    panel.frame_chosen.connect(chosen.append)
    offered = {"a.mae_mm": "a: error, mm", "b.psnr_db": "b: PSNR, dB"}
    panel.offer_metrics(offered, "a.mae_mm", "error\nmm")
    assert panel.metric_box.currentText() == "a: error, mm"
    panel.show_frame(3)  # of which nothing is known
    panel.step_by_metric(-1, sort_order=_DOWN)
    panel.show_frame(chosen[-1])
    panel.step_by_metric(1, sort_order=_DOWN)
    panel.offer_metrics(offered, "b.psnr_db", "figure\ndB")
    panel.show_frame(3)
    panel.step_by_metric(-1, sort_order=_UP)
    assert chosen == [1, 2, 1]


def test_notes_are_saved_and_frames_are_filtered(bubble_window, qtbot, tmp_path):
    panel = bubble_window.window.frames
    known = panel.model
    known.show_metric("touch_depth.contact_mae_mm", "error")
    for frame, error in ((0, None), (1, 0.2), (2, 0.5)):
        figures = {} if error is None else {"touch_depth.contact_mae_mm": error}
        area = 0.0 if error is None else 5.0
        known.show_summary(
            frame, FrameSummary(max_indentation_mm=1.0, contact_area_mm2=area, metrics=figures)
        )
    index = known.index(1, NOTE)
    assert known.flags(index) & Qt.ItemFlag.ItemIsEditable
    assert known.setData(index, " slipped, look again ")
    assert bubble_window.session.notes == {1: "slipped, look again"}
    assert known.data(index) == "slipped, look again"
    assert known.get_summary(2) is not None  # figures do not rest on notes
    for words, listed in (
        ("", [0, 1, 2]),
        (">0.3", [2]),
        ("<0.3", [1]),
        ("contact", [1, 2]),
        ("no-contact", [0]),
        ("noted", [1]),
        ("slip", [1]),
        ("contact >0.1 again", [1]),
        ("nothing-of-the-kind", []),
    ):
        panel.table.filter_line.setText(words)
        assert sorted(panel.table.list_rows()) == listed, words
    panel.table.filter_line.setText("noted")
    assert "1 listed" in panel._told.text()
    panel.step_by_metric(1, sort_order=_DOWN)
    assert bubble_window.session.frame == 1
    bubble_window.save_session(tmp_path / "noted.touch.json")
    assert load_session(tmp_path / "noted.touch.json").notes == {1: "slipped, look again"}
    bubble_window.undo_stack.undo()  # the step to frame 1,
    bubble_window.undo_stack.undo()  # and the note
    assert known.get_note(1) == ""
    assert wait_until_shown(bubble_window, 60)


def test_notes_are_dropped_with_another_recording():
    noted = Session(recording=SAMPLE_RECORDING, notes={3: "good"})
    assert noted.with_updates(frame=4).notes == {3: "good"}
    assert noted.with_updates(recording=SAMPLE_RECORDING.with_name("no_contact.h5")).notes == {}
