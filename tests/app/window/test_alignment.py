"""The alignment dock in a real window: drags preview and are one undo step, refining is offered
and accepted.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from app.align.alignment import AlignmentController
from app.document.session_controller import SessionController
from app.session.layout import Layout
from app.session.sample import SAMPLE_RECORDING
from app.session.state import Session
from app.shell.tour import wait_until_shown
from pipeline.core.geometry import rigid
from pipeline.sensors.alignment import load_alignment

PAIRED = SAMPLE_RECORDING.with_name("digit_gelslim.h5")
TOUCHED = 3  # a frame that both sensors feel
LIMIT_S = 240
WAIT_MS = 240_000
ROUNDING_MM = 1e-4  # depth is kept in single precision
# how near refining on two small touches comes to a truth that it did not begin from
TRUE_TO_MM = 0.25


@pytest.fixture
def settled(qtbot) -> Callable[[SessionController], None]:
    """Waits until stages and dock are through."""

    def wait(controller: SessionController) -> None:
        aligning = controller.findChild(AlignmentController)
        qtbot.waitUntil(lambda: controller.is_idle and aligning.is_idle, timeout=WAIT_MS)

    return wait


@pytest.fixture
def aligned(open_window, qtbot) -> SessionController:
    """A window on a touch of both sensors, its alignment dock in front.

    Only what the dock needs is worked out.
    """
    return _window_with_dock(
        open_window, qtbot, PAIRED, source="digit", target="gelslim", frame=TOUCHED
    )


def _window_with_dock(open_window, qtbot, recording: Path, **session) -> SessionController:
    gl = bool(session.pop("gl", False))
    controller = open_window(gl=gl)
    controller.show_session(Session(recording=recording, layout=Layout(name="align"), **session))
    panel = controller.window.alignment
    qtbot.waitUntil(
        lambda: bool(panel.no_score_reason.text()) or bool(panel.bars.axes), timeout=WAIT_MS
    )
    return controller


def _drag(controller: SessionController, axis: str, to: float, qtbot) -> None:
    """Take hold of a slider and pull it, without letting go."""
    slider = controller.window.alignment.rows[axis].slider
    slider.setSliderDown(True)
    for position in np.linspace(0, to * (20 if axis in "xyz" else 10), 6)[1:]:
        slider.setValue(round(position))
        controller.window.repaint()
        qtbot.wait(5)


def _let_go(controller: SessionController, axis: str) -> None:
    controller.window.alignment.rows[axis].slider.setSliderDown(False)


def test_a_drag_changes_the_view_and_the_gauges_before_it_ends(aligned, qtbot):
    panel = aligned.window.alignment
    column = aligned.window.columns["target_depth"]
    before = column.view.preview
    gauge = panel.gauges["iou"]
    good = gauge.value
    assert before.observed_outline_px.size > 0
    _drag(aligned, "x", 2.0, qtbot)
    qtbot.waitUntil(lambda: column.state == "preview" and gauge.value < good - 0.1, timeout=WAIT_MS)
    assert column.view.preview.pixels.shape == before.pixels.shape
    assert np.mean(column.view.preview.pixels != before.pixels) > 0.01
    assert column.view.preview.observed_outline_px.shape == before.observed_outline_px.shape
    assert gauge.ghost == good
    assert panel.gauges["edge_px"].value > panel.gauges["edge_px"].ghost
    assert aligned.session.offsets.is_zero


def test_gauges_agree_while_dragging_and_at_rest(aligned, qtbot, settled):
    panel = aligned.window.alignment
    _drag(aligned, "x", 1.0, qtbot)
    qtbot.waitUntil(lambda: not aligned.job.is_busy, timeout=WAIT_MS)
    qtbot.wait(50)
    assert panel.dragging
    dragging = {name: gauge.value for name, gauge in panel.gauges.items()}
    assert dragging["iou"] < panel.gauges["iou"].ghost
    _let_go(aligned, "x")
    settled(aligned)
    assert {name: gauge.value for name, gauge in panel.gauges.items()} == dragging


def test_stages_dropped_by_a_drag_are_computed_when_it_ends(aligned, qtbot, settled, monkeypatch):
    """The order is forced: the stages are on their way, and say so, when the drag takes their
    place.
    """
    columns = aligned.window.columns
    evaluator = aligned.evaluator
    begun = threading.Event()

    def for_ever(_session, _wanted, report, **_):
        begun.set()
        while True:
            report.step(0.5, "working")
            time.sleep(0.001)

    with monkeypatch.context() as patched:
        patched.setattr(evaluator, "evaluate_frame", for_ever)
        aligned.change("lay out", layout=Layout())
        aligned.choose_frame(TOUCHED + 1)
        qtbot.waitUntil(
            lambda: begun.is_set() and columns["source"].state == "running", timeout=WAIT_MS
        )
        _drag(aligned, "x", 1.0, qtbot)
        qtbot.waitUntil(
            lambda: not aligned.job.is_busy and columns["target_depth"].state == "preview",
            timeout=WAIT_MS,
        )
        assert columns["source"].state == "stale", "nothing runs"
        assert not aligned.is_idle, "the new frame has not come"
    aligned.change("lay out", layout=Layout(name="align"))
    _let_go(aligned, "x")
    settled(aligned)
    assert aligned.latest_frame.index == TOUCHED + 1
    assert columns["target_depth"].state in ("computed", "warning", "skipped")


def test_a_drag_is_one_undo_step_and_ends_at_full_size(aligned, qtbot, settled):
    panel = aligned.window.alignment
    steps = aligned.undo_stack.count()
    good = panel.gauges["iou"].value
    _drag(aligned, "x", 1.0, qtbot)
    _let_go(aligned, "x")
    settled(aligned)
    assert aligned.undo_stack.count() == steps + 1
    assert "x" in aligned.undo_stack.undoText()
    assert aligned.session.offsets.values == (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert aligned.latest_frame.results["target_depth"].state == "computed"
    assert panel.gauges["iou"].value < good
    assert "moved" in panel.origin.text()
    aligned.undo_stack.undo()
    settled(aligned)
    assert aligned.session.offsets.is_zero
    assert panel.rows["x"].box.value() == 0.0
    assert panel.gauges["iou"].value == good


def test_rotations_are_about_the_centre_of_contact(aligned, qtbot, settled):
    depth = aligned.latest_frame.results["depth"].output
    middle = depth.camera.back_project(depth.depth_mm)[depth.contact].mean(axis=0)
    opened = aligned.views.translation.alignment
    before = rigid.apply(opened.target_from_source, middle)
    _drag(aligned, "rz", 5.0, qtbot)
    _let_go(aligned, "rz")
    settled(aligned)
    offsets = aligned.session.offsets
    assert offsets.rotation_deg == (0.0, 0.0, 5.0)
    assert np.allclose(
        rigid.apply(offsets.apply_to(opened).target_from_source, middle), before, atol=ROUNDING_MM
    )
    # so that turning about the camera's axis would have moved it
    assert np.hypot(*offsets.pivot_mm[:2]) > 1.0


def test_typing_a_number_is_one_undo_step(aligned, settled):
    box = aligned.window.alignment.rows["z"].box
    steps = aligned.undo_stack.count()
    box.stepUp()
    box.stepUp()
    settled(aligned)
    assert aligned.undo_stack.count() == steps + 1
    assert aligned.session.offsets.translation_mm == (0.0, 0.0, 0.1)


def test_a_drag_back_to_the_start_is_no_undo_step(aligned, qtbot, settled):
    steps = aligned.undo_stack.count()
    _drag(aligned, "y", 1.0, qtbot)
    aligned.window.alignment.rows["y"].slider.setValue(0)
    _let_go(aligned, "y")
    settled(aligned)
    assert aligned.undo_stack.count() == steps
    assert aligned.latest_frame.results["target_depth"].state == "cached"


def test_offsets_are_saved_in_the_session_file(aligned, open_window, tmp_path, settled):
    aligned.window.alignment.rows["x"].box.setValue(0.4)
    aligned.window.alignment.rows["ry"].box.setValue(-2.0)
    settled(aligned)
    path = tmp_path / "s.touch.json"
    aligned.save_session(path)
    other = open_window()
    other.open_path(path)
    assert wait_until_shown(other, LIMIT_S)
    assert other.session.offsets == aligned.session.offsets
    assert other.window.alignment.rows["ry"].box.value() == -2.0


def test_refining_shows_before_and_after_and_accepting_is_one_step(aligned, qtbot, settled):
    panel = aligned.window.alignment
    refining = aligned.findChild(AlignmentController).refinement
    panel.rows["x"].box.setValue(1.0)
    settled(aligned)
    steps = aligned.undo_stack.count()
    bad = panel.gauges["iou"].value
    panel.refine.run_bar.start_button.click()
    assert panel.refine.run_bar.cancel_button.isVisible()
    qtbot.waitUntil(lambda: refining.proposal is not None, timeout=WAIT_MS)
    assert "→" in panel.refine.text.text()
    assert "surface mm" in panel.refine.text.text()
    before, after = refining.proposal.refinement.used_fit
    assert after.outline_mm < before.outline_mm
    assert aligned.undo_stack.count() == steps
    panel.refine.accept.click()
    settled(aligned)
    assert aligned.undo_stack.count() == steps + 1
    assert abs(aligned.session.offsets.translation_mm[0]) < TRUE_TO_MM
    assert panel.gauges["iou"].value > bad
    assert not panel.refine.accept.isVisible()


def test_a_proposal_is_shown_against_the_current_alignment(aligned, qtbot, settled):
    """Before left of a handle, after right of it, on whichever frame one goes to."""
    refining = aligned.findChild(AlignmentController).refinement
    view = aligned.window.columns["target_depth"].view
    aligned.window.alignment.rows["x"].box.setValue(1.0)
    settled(aligned)
    plain = view.preview
    aligned.window.alignment.refine.run_bar.start_button.click()
    qtbot.waitUntil(
        lambda: refining.proposal is not None and view.overlay.is_visible, timeout=WAIT_MS
    )
    settled(aligned)
    before = view.preview
    after = view.overlay._picture
    assert before.values.shape == after.values.shape
    gaps = [float(np.nanmean(np.abs(picture.values))) for picture in (before, after)]
    assert gaps[1] < gaps[0]  # reprojected minus recorded
    aligned.choose_frame(TOUCHED + 1)
    settled(aligned)
    aligned.choose_frame(TOUCHED)
    settled(aligned)
    assert view.overlay.is_visible
    aligned.window.alignment.refine.discard.click()
    settled(aligned)
    assert not view.overlay.is_visible
    assert view.preview is plain


def test_refining_can_be_cancelled_and_changes_nothing(aligned, qtbot):
    refining = aligned.findChild(AlignmentController).refinement
    aligned.window.alignment.refine.run_bar.start_button.click()
    aligned.window.alignment.refine.run_bar.cancel_button.click()
    qtbot.waitUntil(aligned.window.alignment.refine.run_bar.start_button.isVisible, timeout=WAIT_MS)
    assert refining.proposal is None
    assert "cancelled" in aligned.window.alignment.refine.text.text()
    assert aligned.session.offsets.is_zero


def test_a_recording_without_target_touch_still_previews(open_window, touch_file, qtbot):
    controller = _window_with_dock(open_window, qtbot, touch_file, target="gelslim", frame=2)
    panel = controller.window.alignment
    assert (
        panel.no_score_reason.text()
        == "the recording has no GelSlim (markers) touch to compare with"
    )
    assert panel.gauges["iou"].text == "-"
    before = controller.window.columns["target_depth"].view.preview
    assert before.observed_outline_px is None
    _drag(controller, "x", 2.0, qtbot)
    qtbot.waitUntil(
        lambda: controller.window.columns["target_depth"].state == "preview", timeout=WAIT_MS
    )
    assert controller.window.columns["target_depth"].view.preview is not before
    panel.refine.run_bar.start_button.click()
    qtbot.waitUntil(controller.window.banner.isVisible, timeout=WAIT_MS)
    assert "both sensors" in controller.window.banner.text


def test_a_saved_alignment_opens_unchanged(aligned, tmp_path, settled):
    aligned.window.alignment.rows["x"].box.setValue(0.5)
    settled(aligned)
    opened = aligned.views.translation.alignment
    expected = aligned.session.offsets.apply_to(opened).target_from_source
    path = tmp_path / "mine.toml"
    aligned.findChild(AlignmentController).save_alignment(path)
    kept = load_alignment(path, source="digit", target="gelslim").alignment
    assert np.allclose(kept.target_from_source, expected, rtol=0, atol=1e-9)
    settled(aligned)
    assert aligned.session.alignment == path
    assert aligned.session.offsets.is_zero
    assert aligned.saved_session.offsets.is_zero  # closing does not ask
    assert "mine.toml" in aligned.window.alignment.origin.text()
    assert np.allclose(
        aligned.views.translation.alignment.target_from_source, expected, rtol=0, atol=1e-9
    )


def test_an_alignment_of_other_sensors_is_reported_and_undone(aligned, qtbot):
    aligned.open_path(SAMPLE_RECORDING.parents[1] / "alignments" / "gelslim_to_soft_bubble.toml")
    qtbot.waitUntil(aligned.window.banner.isVisible, timeout=WAIT_MS)
    assert "gelslim" in aligned.window.banner.text
    assert aligned.session.alignment is None


def test_nothing_is_assessed_while_the_dock_is_hidden(open_window):
    controller = open_window()
    controller.show_session(
        Session(recording=PAIRED, source="digit", target="gelslim", frame=TOUCHED)
    )
    assert wait_until_shown(controller, LIMIT_S)
    assert controller.findChild(AlignmentController).is_idle, "no assessment runs or is about to"
    assert controller.window.alignment.bars.axes == ()
    assert controller.window.columns["target_depth"].view.preview.observed_outline_px is None


def test_going_back_reuses_the_target_comparison(aligned, settled, monkeypatch):
    """Playing with an open dock requests the observed outline of every frame."""
    from app.document import evaluator

    asked: list[int] = []

    def counted(translation, index, *rest):
        asked.append(index)
        return comparison_of(translation, index, *rest)

    comparison_of = evaluator.build_target_comparison
    monkeypatch.setattr(evaluator, "build_target_comparison", counted)
    for frame in (TOUCHED + 1, TOUCHED, TOUCHED + 1, TOUCHED):
        aligned.choose_frame(frame)
        settled(aligned)
    assert aligned.views.get_shown_stage("target_depth").preview.observed_outline_px is not None
    assert asked == [TOUCHED + 1]


def test_offsets_go_with_the_sensors_they_were_made_for(aligned, settled):
    aligned.window.alignment.rows["x"].box.setValue(0.5)
    settled(aligned)
    aligned.change("choose target", target="soft_bubble")
    assert aligned.session.offsets.is_zero
    aligned.undo_stack.undo()
    assert aligned.session.offsets.translation_mm[0] == 0.5
