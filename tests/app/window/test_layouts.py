"""The arrangements of the window: what each shows, what it needs to work out, and that a session
keeps it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PyQt6.QtCore import QSize, Qt

from app.session.layout import Layout
from app.session.sample import SAMPLE_RECORDING
from app.session.state import load_session
from app.shell.tour import wait_until_shown
from pipeline.core.errors import FileProblem
from pipeline.core.typed_data import convert
from widgets.shell.panes import PaneSplitter

LIMIT_S = 240
# Of picture in a pane of two, by the window's size, with any one drawer open: width and height in
# pixels.
PANE_PX = {(1366, 768): (215, 160), (1600, 950): (420, 315), (2560, 1440): (700, 525)}


@pytest.fixture
def window(open_window):
    controller = open_window(SAMPLE_RECORDING, source="gelslim", target="soft_bubble", frame=5)
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    return controller


def _arrange(controller, name: str) -> None:
    controller.window.actions_by_name[f"layout_{name}"].trigger()
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text


def _large(controller) -> list[str]:
    return [name for name, column in controller.window.columns.items() if column.isVisible()]


def test_panes_have_room_with_any_drawer_open(bubble_window, qtbot):
    window = bubble_window
    _arrange(window, "inspect")
    views = [window.window.columns[name].view for name, _ in window.session.layout.panes]
    for size, (wide, high) in PANE_PX.items():
        for drawer in window.window.drawers.all_drawers:
            window.window.resize(*size)
            drawer.toggleViewAction().trigger()

            def roomy(size=size, wide=wide, high=high) -> bool:
                shown = [
                    min(v.canvas.size().width(), v.canvas.size().height() / v.height_over_width)
                    for v in views
                ]
                return window.window.size() == QSize(*size) and all(
                    s >= wide and s * v.height_over_width >= min(high, wide * v.height_over_width)
                    for s, v in zip(shown, views, strict=True)
                )

            qtbot.waitUntil(roomy, timeout=240_000)
            drawer.toggleViewAction().trigger()


def test_a_low_page_folds_its_filmstrip_and_keeps_dragged_splitters(bubble_window, qtbot):
    window = bubble_window
    window.window.resize(1366, 768)
    _arrange(window, "inspect")
    page = window.window.panes
    strip = page.filmstrip
    qtbot.waitUntil(lambda: strip.height() > 70, timeout=240_000)
    window.window.drawers.diagnostics.toggleViewAction().trigger()
    qtbot.waitUntil(lambda: strip.height() < 40, timeout=240_000)
    both = page.panes[0].findChild(PaneSplitter)
    assert both.orientation() == Qt.Orientation.Horizontal
    both.moveSplitter(both.sizes()[0] + 60, 1)
    kept = both.sizes()
    both.fit_sizes()
    assert both.sizes() == kept
    window.window.drawers.diagnostics.toggleViewAction().trigger()
    qtbot.waitUntil(lambda: strip.height() > 70, timeout=240_000)


def test_a_click_shows_a_stage_in_the_active_pane_and_one_key_toggles(window, qtbot):
    whole = _large(window)
    window.window.actions_by_name["toggle_inspect"].trigger()
    assert wait_until_shown(window, LIMIT_S)
    page = window.window.panes
    assert _large(window) == ["depth", "touch_depth"]
    assert {n for n, t in page.filmstrip.thumbnails.items() if t.isVisible()} == set(whole)
    qtbot.mouseClick(window.window.columns["touch_depth"].view.canvas, Qt.MouseButton.LeftButton)
    assert page.active_pane == 1
    qtbot.mouseClick(page.filmstrip.thumbnails["touch"], Qt.MouseButton.LeftButton)
    assert _large(window) == ["depth", "touch"]
    window.window.actions_by_name["only_2"].trigger()  # a stage in another pane changes places
    assert [stage for stage, _ in window.session.layout.panes] == ["touch", "depth"]
    page.dims_chosen.emit(1, "2D")
    assert not window.window.view_panels["depth"].isVisible()
    assert window.window.columns["depth"].isVisible()
    page.count_chosen.emit(3)
    assert len(_large(window)) == 3
    window.window.actions_by_name["toggle_inspect"].trigger()
    assert _large(window) == whole
    window.undo_stack.undo()
    assert len(_large(window)) == 3


def test_warnings_appear_in_header_line_and_strip(window):
    column = window.window.columns["target_depth"]
    assert column.state == "warning"
    assert any("of the target's contact" in warning for warning in column.warnings)
    assert "of the target's contact" in window.window.warning_line.text
    assert window.window.panes.filmstrip.thumbnails["target_depth"].state == "warning"
    window.choose_frame(0)
    assert wait_until_shown(window, LIMIT_S)
    assert column.state == "skipped"
    assert window.window.warning_line.text == ""


def test_the_demo_layout_shows_touch_and_truth(window):
    _arrange(window, "demo")
    assert _large(window) == ["source", "touch"]
    truth = window.views.translation.read_true_outputs(5)["touch"]
    shown = window.window.truth_column.view.preview
    assert window.window.truth_column.isVisible()
    assert shown.caption.startswith("truth: ")
    np.testing.assert_array_equal(shown.distance_mm, truth.image)
    np.testing.assert_allclose(shown.values, truth.reference - truth.image, atol=1e-5)
    # nothing that nobody sees
    assert set(window.latest_frame.results) == {"depth", "cloud", "target_depth", "touch"}
    known = window.window.frames.model.get_summary(5)
    assert known.metrics  # what was known of the whole frame is not forgotten
    _arrange(window, "stages")
    assert not window.window.truth_column.isVisible()


def test_align_shows_the_target_depth_minus_the_observation(window):
    _arrange(window, "align")
    assert _large(window) == ["target_depth"]
    assert window.window.drawers.alignment.isVisible()
    assert wait_until_shown(window, LIMIT_S)
    shown = window.window.columns["target_depth"].view.preview
    assert shown.caption.startswith("reprojected")
    _arrange(window, "demo")
    assert window.views.comparison_mode == ""
    assert not any(drawer.isVisible() for drawer in window.window.drawers.all_drawers)


def test_a_session_stores_the_layout(window, open_window, tmp_path):
    _arrange(window, "inspect")
    window.window.panes.stage_chosen.emit(0, "pose")
    window.save_session(tmp_path / "s.touch.json")
    kept = load_session(tmp_path / "s.touch.json").layout
    assert kept == window.session.layout
    assert kept.panes[0][0] == "pose"
    other = open_window()
    other.open_path(tmp_path / "s.touch.json")
    assert wait_until_shown(other, LIMIT_S)
    assert _large(other) == ["touch_depth", "pose"]


@pytest.mark.parametrize(
    ("data", "field"),
    [
        ({"name": "mine", "panes": []}, "name"),
        ({"name": "inspect", "panes": [["depth", "4D"]]}, "panes"),
        ({"name": "inspect", "panes": []}, "panes"),
        ({"name": "stages", "panes": "depth"}, "panes"),
    ],
)
def test_an_invalid_layout_names_the_key(data, field):
    with pytest.raises(FileProblem, match=rf"the layout cannot be used \({field}") as caught:
        convert(data, Layout, "the layout", Path("a"))
    assert caught.value.field == field


def test_a_stage_outside_the_route_is_replaced():
    layout = Layout(panes=(("depth", "2D"), ("touch_depth", "both")))
    assert layout.resolve_panes(["source", "touch"]) == (("source", "2D"), ("touch", "both"))
    assert layout.resolve_panes(["touch"]) == (("touch", "2D"),)
