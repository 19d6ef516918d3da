"""The Task layout: rows, one tick in every view, attribution, video, damaged
rollouts.
"""

from __future__ import annotations

import shutil

import cv2
import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QGuiApplication

from app.session.state import load_session
from app.task.rollout_attribution import RolloutAttributionController
from app.task.rollouts import RolloutController
from pipeline.lab.tasks.scene_view import ESTIMATE_NAME, TRUE_NAME
from widgets.task.trials_panel import ERROR_MM

# the first grasp compiles kernels where `tactoscope prepare` has not
pytestmark = pytest.mark.timeout(600)
LIMIT_MS = 120_000
FAILS = "hex_key_t2t_0.1mm_003.h5"


def get_part(controller, kind):
    return next(child for child in controller.children() if isinstance(child, kind))


@pytest.fixture
def opened(open_window, rollout_folder, qtbot):
    """A window on the failed rollout by T2T."""
    controller = open_window()
    controller.open_path(rollout_folder)
    rollouts = get_part(controller, RolloutController)
    qtbot.waitUntil(lambda: rollouts.shown is not None, timeout=LIMIT_MS)
    rollouts.choose_trial(rollout_folder / FAILS)
    qtbot.waitUntil(
        lambda: rollouts.shown.rollout.path.name == FAILS and controller.is_idle, timeout=LIMIT_MS
    )
    return controller, rollouts


def test_a_folder_opens_as_rows_at_its_first_failure(open_window, rollout_folder, qtbot):
    controller = open_window(rollout_folder)
    rollouts = get_part(controller, RolloutController)
    qtbot.waitUntil(lambda: rollouts.shown is not None, timeout=LIMIT_MS)
    assert controller.session.layout.name == "task"
    assert controller.window.task.isVisible()
    trials = controller.window.task.trials
    assert [trial.path.name for trial in trials.trials] == sorted(
        path.name for path in rollout_folder.iterdir()
    )
    assert rollouts.shown.rollout.path == trials.trials[0].path == controller.session.recording
    trials.table.sortByColumn(ERROR_MM, Qt.SortOrder.DescendingOrder)
    assert [trial.touch for trial in trials.listed_trials] == ["none", "none", "t2t", "t2t"]
    trials.table.filter_line.setText("t2t fails >0.2")
    assert [trial.path.name for trial in trials.listed_trials] == [FAILS]
    trials.copy_rows()
    titles, row = QGuiApplication.clipboard().text().splitlines()
    assert titles.startswith("trial\tcase\ttouch")
    assert row.split("\t")[1:3] == ["hex_key", "t2t"]
    controller.undo_stack.undo()
    assert controller.session.recording is None


def test_one_rollout_opens_its_layout_and_translates_as_its_controller(
    open_window, rollout_folder, qtbot
):
    controller = open_window()
    controller.open_path(rollout_folder / FAILS)
    rollouts = get_part(controller, RolloutController)
    qtbot.waitUntil(lambda: rollouts.shown is not None and controller.is_idle, timeout=LIMIT_MS)
    assert controller.session.layout.name == "task"
    assert (controller.session.route, dict(controller.session.methods)) == ("t2t", {"touch": "t2t"})
    views = controller.window.task.views
    qtbot.waitUntil(lambda: views["truth"].preview is not None, timeout=LIMIT_MS)
    opened = controller.views.translation
    np.testing.assert_array_equal(views["source"].preview.pixels, opened.stream.frame(0).image)
    truth = opened.recording.stream("soft_bubble_left").frame(0)
    np.testing.assert_array_equal(views["truth"].preview.distance_mm, truth.image)
    controller.window.task.place_box.chosen.emit("gelslim_right")
    qtbot.waitUntil(
        lambda: controller.is_idle and controller.views.translation is not opened, timeout=LIMIT_MS
    )
    opened = controller.views.translation
    truth = opened.recording.stream("soft_bubble_right").frame(0)
    np.testing.assert_array_equal(views["truth"].preview.distance_mm, truth.image)


def test_one_cursor_moves_plot_scene_and_slider(opened, qtbot, monkeypatch):
    controller, rollouts = opened
    page = controller.window.task
    shown = rollouts.shown
    moved = {}

    def show(_view, layers, **_):
        moved.update({layer.name: layer.view_from_layer for layer in layers})

    monkeypatch.setattr(controller.views.scene, "show_layers", show)
    page.plot.step_chosen.emit(12)
    assert (controller.tick, page.plot.current_step, page.ticks.frame) == (12, 12, 12)
    np.testing.assert_array_equal(moved[TRUE_NAME], shown.rollout.world_from_object[12])
    off = np.linalg.inv(moved[TRUE_NAME]) @ moved[ESTIMATE_NAME]
    decision = shown.rollout.summary.decisions[0]
    gap = np.hypot(*(decision.estimate[name] - decision.truth[name] for name in ("x_mm", "y_mm")))
    assert np.linalg.norm(off[:3, 3]) == pytest.approx(gap, abs=1e-4)
    assert page.scene.legend.text().startswith("tick 12 of ")
    controller.window.actions_by_name["next"].trigger()
    assert page.ticks.frame == controller.tick == 13
    assert list(page.plot.marks) == [0]
    controller.window.actions_by_name["next_decision"].trigger()
    assert controller.tick == 0
    before = controller.undo_stack.count()
    controller.set_tick(5)
    assert controller.undo_stack.count() == before


def test_a_session_keeps_trial_and_tick(opened, open_window, tmp_path, qtbot):
    controller, _ = opened
    controller.set_tick(9)
    controller.save_session(tmp_path / "s.touch.json")
    assert load_session(tmp_path / "s.touch.json").tick == 9
    other = open_window()
    other.open_path(tmp_path / "s.touch.json")
    rollouts = get_part(other, RolloutController)
    qtbot.waitUntil(lambda: rollouts.shown is not None, timeout=LIMIT_MS)
    assert other.session.layout.name == "task"
    assert (rollouts.shown.rollout.path.name, other.window.task.plot.current_step) == (FAILS, 9)


def test_attribution_runs_when_asked_adds_up_and_is_kept(opened, qtbot):
    controller, rollouts = opened
    panel = controller.window.task.decision
    attribution = get_part(controller, RolloutAttributionController)
    assert panel.sentence.text().startswith("fails by 0.3 mm off the hole's axis")
    assert panel.waterfall.bars == ()
    panel.run_bar.start_button.click()
    assert attribution.is_busy
    qtbot.waitUntil(lambda: not attribution.is_busy, timeout=LIMIT_MS)
    bars = panel.waterfall.bars
    assert sum(-bar.change for bar in bars[1:]) == pytest.approx(bars[0].end)
    assert bars[1].title == "generated touch \N{CHECK MARK} succeeds"
    assert panel.sentence.text().endswith("with the true touch it succeeds")
    controller.window.actions_by_name["next_trial"].trigger()
    qtbot.waitUntil(lambda: rollouts.shown.rollout.path.name != FAILS, timeout=LIMIT_MS)
    assert "succeeds: there is no failure" in panel.sentence.text()
    controller.undo_stack.undo()
    qtbot.waitUntil(lambda: rollouts.shown.rollout.path.name == FAILS, timeout=LIMIT_MS)
    assert panel.waterfall.bars == bars
    assert not attribution.is_busy


def test_attribution_can_be_cancelled(opened, qtbot):
    controller, _ = opened
    panel = controller.window.task.decision
    attribution = get_part(controller, RolloutAttributionController)
    panel.run_bar.start_button.click()
    panel.run_bar.cancel_button.click()
    qtbot.waitUntil(lambda: not attribution.is_busy, timeout=LIMIT_MS)
    assert panel.waterfall.bars == ()
    assert panel.run_bar.start_button.isEnabled()


def test_video_has_one_image_per_tick(opened, tmp_path, qtbot):
    _, rollouts = opened
    rollouts.write_video(tmp_path / "why.avi")
    qtbot.waitUntil((tmp_path / "why.avi").exists, timeout=LIMIT_MS)
    reader = cv2.VideoCapture(str(tmp_path / "why.avi"))
    images = []
    while (read := reader.read())[0]:
        images.append(read[1])
    assert len(images) == rollouts.shown.rollout.n_ticks
    assert np.abs(images[0].astype(float) - images[-1]).max() > 100


def test_nothing_is_read_while_another_layout_is_shown(opened, rollout_folder, qtbot, monkeypatch):
    controller, rollouts = opened
    controller.window.actions_by_name["layout_look"].trigger()
    monkeypatch.setattr(
        "app.task.rollouts.open_rollout", lambda *_: pytest.fail("read while hidden")
    )
    controller.change("open recording", recording=rollout_folder / FAILS.replace("0.1mm", "2mm"))
    qtbot.waitUntil(lambda: controller.is_idle and not rollouts.is_busy, timeout=LIMIT_MS)
    assert not controller.window.task.isVisible()
    assert controller.window.timeline.isVisible()


def test_damaged_and_other_files_end_in_one_sentence(
    open_window, rollout_folder, touch_file, tmp_path, qtbot
):
    shutil.copy(rollout_folder / FAILS, tmp_path / "b.h5")
    (tmp_path / "a.h5").write_bytes((rollout_folder / FAILS).read_bytes()[:1000])
    controller = open_window()
    controller.open_path(tmp_path)
    rollouts = get_part(controller, RolloutController)
    page = controller.window.task
    qtbot.waitUntil(lambda: rollouts.shown is not None, timeout=LIMIT_MS)
    assert rollouts.shown.rollout.path.name == "b.h5"
    page.trials.trial_chosen.emit(tmp_path / "a.h5")
    assert "a.h5" in page.message.text()
    controller.open_path(touch_file)
    controller.window.actions_by_name["layout_task"].trigger()
    qtbot.waitUntil(lambda: "no rollout" in page.message.text(), timeout=LIMIT_MS)
    assert rollouts.shown is None
    assert not page.scene.isVisible()
