"""Frames, trace, log, steps and the banner."""

from __future__ import annotations

import logging

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QApplication, QComboBox, QLabel, QPushButton

from widgets.compare.comparison_tab import GridTab
from widgets.frames.frame_summary import FrameSummary
from widgets.frames.frames_model import CONTACT, DEPTH, FRAME, METRIC
from widgets.frames.frames_panel import FramesPanel
from widgets.shell.banner import Banner
from widgets.shell.log_panel import LogPanel
from widgets.stages.probes_panel import TracePanel
from widgets.style.plots import Strip, StripPlot
from widgets.style.theme import get_theme_colours, to_hex


def test_the_banner_is_hidden_until_there_is_a_problem(qtbot):
    banner = Banner()
    qtbot.addWidget(banner)
    assert banner.isHidden()
    banner.show_problem("no such file: 'a.h5'")
    assert not banner.isHidden()
    assert banner.text == "No such file: 'a.h5'"
    banner.hide()
    assert banner.isHidden()


def test_the_banner_offers_details_only_where_there_are_any(qtbot):
    banner = Banner()
    qtbot.addWidget(banner)
    more = next(b for b in banner.findChildren(QPushButton) if b.text() == "Details")
    banner.show_problem("a")
    assert more.isHidden()
    banner.show_problem("b", "Traceback …")
    assert not more.isHidden()


def test_a_report_can_be_copied(qtbot):
    banner = Banner()
    qtbot.addWidget(banner)
    banner.show_problem("it broke", "line 3")
    banner.copy_report()
    assert QApplication.clipboard().text() == "It broke\n\nline 3\n"


def test_the_list_of_frames_is_a_sound_model_and_fills_lazily(qtbot, qtmodeltester):
    panel = FramesPanel()
    qtbot.addWidget(panel)
    panel.model.reset_frames(5)
    qtmodeltester.check(panel.model)
    panel.model.show_summary(2, FrameSummary(max_indentation_mm=0.5, contact_area_mm2=12.34))
    cells = [panel.model.data(panel.model.index(2, c)) for c in (FRAME, DEPTH, CONTACT, METRIC)]
    assert cells == ["2", "0.50", "12.3", "-"]
    assert panel.model.data(panel.model.index(3, 1)) == ""


def test_the_trace_reads_like_a_sentence(qtbot):
    panel = TracePanel()
    qtbot.addWidget(panel)
    panel.show_steps([("source", "(1, 2)"), ("depth", "0.8 mm")])
    assert panel.text == "(1, 2) → 0.8 mm"
    panel.show_steps([])
    assert panel.text == ""


@pytest.mark.parametrize("waits", [False, True])
def test_a_trace_that_only_waits_is_no_alarm(qtbot, waits):
    panel = TracePanel()
    qtbot.addWidget(panel)
    panel.show_steps([("depth", "(1, 2)")], ending="so far", is_waiting=waits)
    assert (
        to_hex(get_theme_colours(panel.palette()).warning_text) in panel.findChild(QLabel).text()
    ) != waits


def test_the_log_is_filtered_by_level_and_keeps_what_is_hidden(qtbot):
    panel = LogPanel()
    qtbot.addWidget(panel)
    panel.show_line(logging.INFO, "opened")
    panel.show_line(logging.ERROR, "failed")
    level = panel.findChild(QComboBox, "log_level")
    level.setCurrentText("errors")
    assert panel.text == "failed"
    level.setCurrentText("info")
    assert panel.text == "opened\nfailed"


def test_a_grid_offers_axes_with_values_and_keeps_what_is_chosen(qtbot):
    tab = GridTab()
    metrics = {"touch_depth.contact_mae_mm": "touch depth: error in contact, mm", "": "time only"}
    qtbot.addWidget(tab)
    axes = {"touch.guidance": "1, 4", "touch.steps": "4, 8", "touch.seed": "0, 1"}
    tab.offer_axes(axes, metrics, "", {})
    assert [tab.metric_box.itemText(i) for i in range(2)] == list(metrics.values())
    assert (tab.metric_box.currentText(), tab.metric_box.currentData()) == ("time only", "")
    assert tab.axis_texts == ("touch.guidance=1, 4", "touch.steps=4, 8")
    tab.values[0].setText("2")
    tab.axes[1].setCurrentIndex(0)
    tab.axes[1].chosen.emit("")
    tab.offer_axes({**axes, "depth.method": "physics, network"}, metrics, "", {})
    assert tab.axis_texts == ("touch.guidance=2", "")
    tab.offer_axes({"depth.method": "physics, network"}, metrics, "", {})
    assert tab.axis_texts == ("depth.method=physics, network", "")


def test_a_plot_of_steps_chooses_by_cursor_and_keys_and_marks_what_others_choose(qtbot):
    plot = StripPlot("steps", "metrics of every step")
    qtbot.addWidget(plot)
    plot.resize(400, 200)
    plot.show()
    values = [(1.0, 0.5, float("nan"), 0.1), (4.0, 3.0, 2.0, 1.0)]
    plot.show_strips(
        [Strip(title=f"strip {k}, mm", curves=(("", v),)) for k, v in enumerate(values)], marks=(1,)
    )
    plot.show_step(2)
    assert [cursor.value() for cursor in plot._cursors] == [2, 2]
    with qtbot.waitSignal(plot.step_chosen) as chosen:
        plot._cursors[1].setValue(0.8)
    assert chosen.args == [1]
    with qtbot.waitSignal(plot.step_chosen) as chosen:
        qtbot.keyClick(plot, Qt.Key.Key_End)
    assert chosen.args == [3]
    plot.show_strips(())
    assert (plot.n_steps, len(plot._axes)) == (0, 0)
    qtbot.keyClick(plot, Qt.Key.Key_Home)
