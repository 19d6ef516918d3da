"""The layouts: what each shows, what it needs to work out, and that a session keeps it."""

from __future__ import annotations

import json
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
from widgets.views.view_3d import View3D

LIMIT_S = 240
STAGES = ["source", "depth", "cloud", "target_depth", "touch", "touch_depth", "pose"]
# least width in pixels of the largest image, and share of the window that shows touches, by size
ROOM = {(1366, 768): (370, 0.5), (1600, 950): (420, 0.6), (2560, 1440): (700, 0.65)}


@pytest.fixture
def window(open_window):
    controller = open_window(
        SAMPLE_RECORDING, source="gelslim", target="soft_bubble", frame=5, route="t2d2"
    )
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    return controller


def _arrange(controller, name: str) -> None:
    controller.window.actions_by_name[f"layout_{name}"].trigger()
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text


def _large(controller) -> list[str]:
    return [name for name, column in controller.window.columns.items() if column.isVisible()]


def _panes(controller) -> list[str]:
    return [name for name, _ in controller.session.layout.panes]


def _measure(window) -> tuple[float, float]:
    """Width of the largest image, and the share of the window that images and 3D views have."""
    views = [column.view for column in window.columns.values() if column.view.canvas.isVisible()]
    images = [
        (min(v.canvas.width(), v.canvas.height() / v.height_over_width), v.height_over_width)
        for v in views
    ]
    area = sum(wide * wide * tall for wide, tall in images)
    area += sum(v.width() * v.height() for v in window.findChildren(View3D) if v.isVisible())
    area += sum(
        (card.width() - 8) * 82
        for card in window.look.filmstrip.thumbnails.values()
        if card.isVisible()
    )
    area += sum(
        image.width() * image.height() for image in window.timeline.errors.thumbnails.values()
    )
    return max(wide for wide, _ in images), area / (window.width() * window.height())


@pytest.mark.ranks_frames
def test_most_of_the_window_shows_touches(window, qtbot):
    model = window.window.frames.model
    qtbot.waitUntil(lambda: len(model.thumbnails) > 8, timeout=240_000)
    for size, (least_px, least_share) in ROOM.items():

        def roomy(size=size, least_px=least_px, least_share=least_share) -> bool:
            window.window.resize(*size)
            largest_px, share = _measure(window.window)
            return largest_px >= least_px and share >= least_share

        qtbot.waitUntil(roomy, timeout=240_000)


def test_the_inspector_folds_in_a_small_window_and_returns_in_a_large_one(bubble_window, qtbot):
    window = bubble_window.window
    for size, shown in (((1600, 950), True), ((1366, 768), False), ((1600, 950), True)):

        def has_size(size=size) -> bool:
            window.resize(*size)
            return window.size() == QSize(*size)

        qtbot.waitUntil(has_size, timeout=240_000)
        qtbot.waitUntil(lambda shown=shown: window.inspector.isVisible() == shown, timeout=240_000)
    window.actions_by_name["inspector"].trigger()
    assert not window.inspector.isVisible()
    _arrange(bubble_window, "align")
    window.show_inspector()
    assert window.inspector.isVisible()
    assert bubble_window.session.layout.name == "look"


def test_a_low_page_collapses_its_cards_and_keeps_dragged_splitters(bubble_window, qtbot):
    window = bubble_window.window
    window.resize(1366, 768)
    strip = window.look.filmstrip
    qtbot.waitUntil(lambda: strip.height() > 70, timeout=240_000)
    window.drawers.diagnostics.toggleViewAction().trigger()
    qtbot.waitUntil(lambda: strip.height() < 40, timeout=240_000)
    both = window.look.panes[0].findChild(PaneSplitter)
    assert both.orientation() == Qt.Orientation.Horizontal
    both.moveSplitter(both.sizes()[0] + 60, 1)
    kept = both.sizes()
    both.fit_sizes()
    assert both.sizes() == kept
    window.drawers.diagnostics.toggleViewAction().trigger()
    qtbot.waitUntil(lambda: strip.height() > 70, timeout=240_000)


def test_a_card_shows_its_stage_large_and_keys_do_the_same(window, qtbot):
    page = window.window.look
    assert {n for n, t in page.filmstrip.thumbnails.items() if t.isVisible()} == set(STAGES)
    assert _panes(window) == ["source", "touch_depth", "touch"]
    assert page.active_pane == 1
    qtbot.mouseClick(page.filmstrip.thumbnails["depth"], Qt.MouseButton.LeftButton)
    assert _panes(window) == ["source", "depth", "touch"]
    assert _large(window) == ["source", "depth", "touch"]
    window.window.actions_by_name["stage_5"].trigger()  # in a pane, which becomes the active one
    assert page.active_stage == "touch"
    window.window.actions_by_name["stage_7"].trigger()
    assert _panes(window) == ["source", "depth", "pose"]
    page.dims_chosen.emit(2, "2D")
    assert not window.window.view_panels["pose"].isVisible()
    assert window.window.columns["pose"].isVisible()
    window.undo_stack.undo()
    assert _panes(window) == ["source", "touch_depth", "touch"], "consecutive changes are one step"


def test_control_and_a_click_add_a_pane_and_remove_it(window, qtbot):
    card = window.window.look.filmstrip.thumbnails
    control = Qt.KeyboardModifier.ControlModifier
    for stage, panes in (
        ("touch", ["source", "touch_depth"]),
        ("depth", ["source", "touch_depth", "depth"]),
        ("pose", ["source", "touch_depth", "pose"]),  # in place of the last of three
    ):
        qtbot.mouseClick(card[stage], Qt.MouseButton.LeftButton, control)
        assert _panes(window) == panes
    for stage in ("pose", "touch_depth", "source"):
        qtbot.mouseClick(card[stage], Qt.MouseButton.LeftButton, control)
    assert _panes(window) == ["source"], "the last one stays"


def test_the_verdict_says_how_far_off_and_why_and_leads_there(window, qtbot):
    window.choose_method("touch", "t2d2")  # whose largest error lies outside the source's view
    assert wait_until_shown(window, LIMIT_S)
    verdict = window.window.verdict
    assert verdict.sentence.startswith("Frame 5 is 0.36 mm off.")
    assert any("of the target's contact" in finding.sentence for finding in verdict.findings)
    qtbot.waitUntil(lambda: "of it: the source saw 66" in verdict.sentence, timeout=240_000)
    assert "0.304 mm" in window.window.look.filmstrip.thumbnails["target_depth"].share[1]
    show = next(button for button in verdict.buttons if button.text() == "Show where")
    qtbot.mouseClick(show, Qt.MouseButton.LeftButton)
    assert wait_until_shown(window, LIMIT_S)
    assert "target_depth" in _large(window)
    assert window.views.comparison_mode == "difference"
    window.choose_frame(0)
    assert wait_until_shown(window, LIMIT_S)
    assert window.window.columns["target_depth"].state == "skipped"
    assert verdict.sentence.startswith("Frame 0 has no contact.")
    assert verdict.findings == ()


def test_a_layout_that_computes_no_stage_has_no_verdict(window):
    verdict = window.window.verdict
    assert "mm off" in verdict.sentence
    window.window.actions_by_name["layout_track"].trigger()
    assert wait_until_shown(window, LIMIT_S)
    assert not window.latest_frame.results
    assert verdict.sentence == "", "not that there is no warning and no truth"
    window.window.actions_by_name["layout_look"].trigger()
    assert wait_until_shown(window, LIMIT_S)
    assert "mm off" in verdict.sentence


def test_without_truth_the_verdict_is_the_first_warning(bubble_window):
    bubble_window.change("move", offsets=bubble_window.session.offsets)
    verdict = bubble_window.window.verdict
    warnings = [
        warning
        for result in bubble_window.latest_frame.results.values()
        for warning in result.warnings
    ]
    if warnings:
        assert warnings[0] in verdict.sentence
    else:
        assert "no warning" in verdict.sentence


def test_the_recorded_touch_lies_under_a_wipe_of_the_generated_one(window):
    view = window.window.columns["touch"].view
    truth = window.views.translation.read_true_outputs(5)["touch"]
    assert view.overlay.is_visible
    under = view.overlay._picture
    np.testing.assert_allclose(under.values, truth.reference - truth.image, atol=1e-5)
    assert under.scale == view.preview.scale, "one scale on both sides"
    assert not window.window.columns["target_depth"].view.overlay.is_visible
    assert set(window.latest_frame.results) == set(STAGES) - {"source"}


def test_a_changed_parameter_marks_the_stages_from_it_on_and_dims_none(window, qtbot):
    touch = window.window.columns["touch"]
    before = touch.view.canvas.grab().toImage()
    marked = set()
    for name, column in window.window.columns.items():
        column.state_shown.connect(
            lambda state, _, name=name: marked.add(name) if state in ("stale", "running") else None
        )
    method = next(m for m in window.methods if m.stage == "touch")
    window.choose_params(method.key, type(window.session.get_params(method))(seed=3))
    window.views.mark_stale()
    assert touch.view.canvas.grab().toImage() == before
    assert wait_until_shown(window, LIMIT_S)
    assert "touch" in marked
    assert not marked & {"source", "depth", "cloud", "target_depth"}


def test_align_shows_the_target_depth_minus_the_observation(window):
    _arrange(window, "align")
    assert _large(window) == ["target_depth"]
    heads = [name for name, c in window.window.columns.items() if c.head.isVisible()]
    assert heads == ["target_depth"]
    assert window.window.scene_panel.isVisible(), "right of it, in 3D"
    assert window.window.drawers.alignment.isVisible()
    assert wait_until_shown(window, LIMIT_S)
    shown = window.window.columns["target_depth"].view.preview
    assert shown.caption.startswith("reprojected")
    _arrange(window, "look")
    assert window.views.comparison_mode == ""
    assert not any(drawer.isVisible() for drawer in window.window.drawers)


def test_a_session_stores_the_layout(window, open_window, tmp_path):
    window.window.look.stage_chosen.emit(0, "pose")
    window.save_session(tmp_path / "s.touch.json")
    assert "s.touch.json" in window.window.said
    kept = load_session(tmp_path / "s.touch.json").layout
    assert kept == window.session.layout
    assert kept.panes[0][0] == "pose"
    other = open_window()
    other.open_path(tmp_path / "s.touch.json")
    assert wait_until_shown(other, LIMIT_S)
    assert [name for name, _ in other.session.layout.panes] == ["pose", "touch_depth", "touch"]


@pytest.mark.parametrize("old", ["stages", "inspect", "demo"])
def test_a_session_of_an_older_layout_opens_in_look(window, tmp_path, old):
    path = tmp_path / "s.touch.json"
    window.save_session(path)
    data = json.loads(path.read_text())
    data["layout"]["name"] = old
    path.write_text(json.dumps(data))
    assert load_session(path).layout.name == "look"


@pytest.mark.parametrize(
    ("data", "field"),
    [
        ({"name": "mine", "panes": []}, "name"),
        ({"name": "look", "panes": [["depth", "4D"]]}, "panes"),
        ({"name": "look", "panes": []}, "panes"),
        ({"name": "look", "panes": "depth"}, "panes"),
        ({"name": "demo"}, "name"),
    ],
)
def test_an_invalid_layout_names_the_key(data, field):
    with pytest.raises(FileProblem, match=rf"the layout cannot be used \({field}"):
        convert(data, Layout, "the layout", Path("a"))


def test_a_stage_outside_the_route_is_replaced():
    layout = Layout(panes=(("depth", "2D"), ("touch_depth", "both")))
    assert layout.resolve_panes(["source", "touch"]) == (("source", "2D"), ("touch", "both"))
    assert layout.resolve_panes(["touch"]) == (("touch", "2D"),)
