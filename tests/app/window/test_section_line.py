"""The section line by mouse, key and number: in every picture on the same millimetres, and its
curves in the tab.
"""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtWidgets import QApplication

from app.session.sample import SAMPLE_RECORDING
from app.session.state import load_session
from app.shell.tour import wait_until_shown
from pipeline.core.errors import FileProblem
from pipeline.translation import cross_section
from pipeline.translation.cross_section import SectionLine
from widgets.stages.section_plot import SectionPlot
from widgets.views.canvas import Canvas

LIMIT_S = 240
_Left = Qt.MouseButton.LeftButton
_Shift = Qt.KeyboardModifier.ShiftModifier


@pytest.fixture
def window(open_window):
    controller = open_window(SAMPLE_RECORDING, source="gelslim", target="soft_bubble", frame=5)
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    return controller


@pytest.fixture
def counted(monkeypatch):
    """How often something was cut, and a line or a plot drawn."""
    counts = {"cut": 0, "line": 0, "plot": 0}

    def count(owner, name, what):
        real = getattr(owner, name)

        def counting(*args, **kwargs):
            counts[what] += 1
            return real(*args, **kwargs)

        monkeypatch.setattr(owner, name, counting)

    count(cross_section, "sample_bilinear", "cut")
    count(Canvas, "_draw_line", "line")
    count(SectionPlot, "_show_profiles", "plot")
    return counts


def _on(controller, qtbot):
    controller.window.actions_by_name["section_line"].trigger()
    qtbot.waitUntil(
        lambda: controller.window.section_panel.plot.section is not None, timeout=240_000
    )
    views = [column.view for column in controller.window.columns.values()]
    rooms = None
    while rooms != (
        rooms := [view.canvas.size() for view in views]
    ):  # the drawer that opens takes room from the pictures
        qtbot.wait(50)
    return controller.window.section_panel


def test_the_line_text_fits_a_small_window(bubble_window, qtbot):
    bubble_window.window.resize(1366, 768)
    tab = _on(bubble_window, qtbot)
    bubble_window.set_section(SectionLine(begin_mm=(-60.0, 0.0), end_mm=(60.0, 0.0)))
    label = tab.message

    def whole() -> bool:
        return (
            "120.00 mm" in label.text()
            and label.fontMetrics().horizontalAdvance(label.text()) <= label.width()
        )

    qtbot.waitUntil(whole, timeout=240_000)


def test_the_section_computes_only_what_is_visible(bubble_window, counted, qtbot):
    window = bubble_window.window
    for frame in (1, 2):
        bubble_window.choose_frame(frame)
        assert wait_until_shown(bubble_window, LIMIT_S)
    assert counted == {"cut": 0, "line": 0, "plot": 0}
    _on(bubble_window, qtbot)
    window.repaint()
    assert all(counted.values())
    window.drawers.diagnostics.hide()
    bubble_window.choose_frame(1)
    assert wait_until_shown(bubble_window, LIMIT_S)
    cut = counted["cut"]
    qtbot.wait(60)
    assert counted["cut"] == cut  # nobody sees the curves
    window.actions_by_name["section_line"].trigger()
    qtbot.wait(30)
    drawn = counted["line"]
    window.repaint()
    bubble_window.choose_frame(2)
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert (counted["cut"], counted["line"]) == (cut, drawn)


def test_every_stage_with_heights_has_a_curve_equal_to_its_pixels(window, qtbot):
    panel = _on(window, qtbot)
    shown = panel.plot.section
    assert {p.name for p in shown.profiles} == {
        "depth",
        "cloud",
        "target_depth",
        "touch",
        "touch_depth",
        "true_source",
        "true_target",
    }
    depth = window.latest_frame.results["depth"].output
    (profile,) = (p for p in shown.profiles if p.name == "depth")
    deepest = np.nanmax(np.where(depth.contact, depth.indentation_mm, np.nan))
    # the first line goes through it
    assert np.nanmax(profile.heights_mm) == pytest.approx(deepest, abs=0.02)
    assert len(profile.contact_edges_mm) >= 2
    assert shown.along_mm[-1] == pytest.approx(shown.line.length_mm)
    for name, column in window.window.columns.items():
        assert column.view.canvas.line is not None, name
    panel.sensor_box.chosen.emit("source")
    # on their own scale
    assert {p.name for p in panel.plot.visible_profiles} == {"depth", "true_source"}
    panel.copy.click()
    rows = list(csv.DictReader(io.StringIO(QApplication.clipboard().text())))
    at = int(np.nanargmax(profile.heights_mm))
    assert float(rows[at]["depth_mm"]) == pytest.approx(float(profile.heights_mm[at]), abs=1e-5)


def test_the_same_place_of_the_touch_lies_under_the_line_in_both_sensors(window, qtbot):
    """Where the cloud's point comes from a pixel under an end, the target's view has it under
    that end.
    """
    made = window.latest_frame.results["target_depth"].output
    depth, cloud = (window.latest_frame.results[name].output for name in ("depth", "cloud"))
    row, col = divmod(
        int(np.where(made.contact, made.indentation_mm, -1.0).argmax()), made.camera.cols
    )
    pixel = divmod(int(cloud.source_index[int(made.source_index[row, col])]), depth.camera.cols)
    sheet = cross_section.build_plane(window.views.translation, "source", depth.camera)
    window.set_section(
        SectionLine(begin_mm=sheet.backproject_to_mm(pixel[1], pixel[0]), end_mm=(0.0, 0.0))
    )
    canvas = window.window.columns["target_depth"].view.canvas
    qtbot.waitUntil(lambda: canvas.line is not None, timeout=240_000)
    begin = canvas.line[0]
    off_mm = (
        np.hypot(begin.x() - col - 0.5, begin.y() - row - 0.5)
        * window.window.columns["target_depth"].view.preview.pixel_mm
    )
    assert off_mm < 0.5  # the touch is that deep, and seen aslant


def test_a_drag_draws_the_line_or_moves_an_end_and_others_pan(window, qtbot):
    _on(window, qtbot)
    canvas = window.window.columns["touch_depth"].view.canvas
    places = [
        QPoint(int(s * canvas.width()), int(t * canvas.height()))
        for s, t in ((0.4, 0.4), (0.6, 0.5), (0.5, 0.6))
    ]
    qtbot.mousePress(canvas, _Left, _Shift, places[0])
    qtbot.mouseMove(canvas, places[1])
    qtbot.mouseRelease(canvas, _Left, _Shift, places[1])
    centre = canvas.centre

    def ends_at(begin: QPoint, end: QPoint) -> bool:
        return all(
            (canvas.to_screen(found) - wanted.toPointF()).manhattanLength() < 3.0
            for found, wanted in zip(canvas.line, (begin, end), strict=True)
        )

    qtbot.waitUntil(lambda: ends_at(*places[:2]), timeout=240_000)
    qtbot.mousePress(canvas, _Left, pos=places[1])
    qtbot.mouseMove(canvas, places[2])
    qtbot.mouseRelease(canvas, _Left, pos=places[2])
    qtbot.waitUntil(lambda: ends_at(places[0], places[2]), timeout=240_000)
    assert canvas.centre == centre
    index = window.undo_stack.index()
    line = window.section
    qtbot.mousePress(canvas, _Left, pos=QPoint(5, 5))
    qtbot.mouseMove(canvas, QPoint(30, 30))
    qtbot.mouseRelease(canvas, _Left, pos=QPoint(30, 30))
    assert canvas.centre != centre
    assert (window.undo_stack.index(), window.section) == (index, line)  # no step of undo


def test_the_line_is_set_by_numbers_and_saved_but_not_undone(window, qtbot, tmp_path):
    panel = _on(window, qtbot)
    for box, value in zip(panel.ends, (-2.0, 1.5, 3.25, -1.0), strict=True):
        box.setValue(value)
    wanted = SectionLine(begin_mm=(-2.0, 1.5), end_mm=(3.25, -1.0))
    assert window.section == wanted
    window.change("choose another", frame=4)
    window.undo_stack.undo()
    assert window.section == wanted
    path = tmp_path / "kept.touch.json"
    window.save_session(path)
    assert load_session(path).section == wanted
    window.window.actions_by_name["section_line"].trigger()
    assert window.section is None
    assert not panel.ends[0].isEnabled()
    window.window.actions_by_name["section_line"].trigger()
    assert window.section == wanted  # where it was
    window.set_section(None)
    window.open_session(path)
    assert window.section == wanted
    assert window.window.actions_by_name["section_line"].isChecked()
    path.write_text(path.read_text().replace("3.25", "true"))
    with pytest.raises(FileProblem, match=r"section\[2\]"):
        load_session(path)


def test_the_curves_of_one_sensor_are_drawn_with_gaps_when_the_plot_is_shown(qtbot):
    along = np.linspace(0.0, 10.0, 50)
    known = np.where(along > 5.0, 0.05 * along, np.nan)
    profiles = [
        cross_section.HeightProfile(name=name, title=name, place=place, heights_mm=heights)
        for name, place, heights in (
            ("depth", "source", 0.1 * along),
            ("touch_depth", "target", known),
            ("touch", "target", np.full(50, np.nan)),
        )
    ]
    line = SectionLine(begin_mm=(0.0, 0.0), end_mm=(10.0, 0.0))
    plot = SectionPlot()
    qtbot.addWidget(plot)
    plot.show_section(
        cross_section.CrossSection(line=line, along_mm=along, profiles=tuple(profiles))
    )
    assert not plot._axes, "nothing is drawn that nobody sees"
    plot.show()
    plot.show_sensor_role("target")
    (curve,) = plot._curves.values()
    np.testing.assert_array_equal(curve.yData, known)
    assert [label.text for _, label in plot._legend.items] == ["touch_depth"]
