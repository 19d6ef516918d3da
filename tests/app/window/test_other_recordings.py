"""What a new recording takes over from the one before: no alignment of other sensors, no truth,
no target of its own.
"""

from __future__ import annotations

import pytest
from PyQt6.QtWidgets import QLabel, QPushButton

from app.document.session_controller import SessionController
from app.frames.frame_ranking import FrameRankingController
from app.session.sample import SAMPLE_RECORDING
from app.session.state import Session
from app.shell.mending import MendingController
from app.shell.tour import wait_until_shown
from pipeline.translation.reports.presentation import name_pane

LIMIT_S = 240
RECORDINGS = SAMPLE_RECORDING.parent
ALIGNMENTS = RECORDINGS.parent / "alignments"
DIGIT = RECORDINGS / "digit_gelslim.h5"
GRASPS = RECORDINGS / "grasps_cross.h5"
OF_DIGIT = ALIGNMENTS / "digit_to_gelslim.toml"
OF_GELSLIM = ALIGNMENTS / "gelslim_to_soft_bubble.toml"


def click(buttons: list[QPushButton], words: str) -> None:
    next(button for button in buttons if button.text() == words).click()


def list_texts(buttons: list[QPushButton]) -> list[str]:
    return [button.text() for button in buttons]


def notification(controller: SessionController):
    return controller.findChild(MendingController).notification


def test_an_alignment_of_other_sensors_is_dropped_and_can_be_used_again(open_window):
    controller = open_window(DIGIT, target="gelslim")
    controller.open_path(OF_DIGIT)
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    controller.open_path(GRASPS)
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    opened = controller.views.translation
    assert (opened.request.recording, opened.target.name) == (GRASPS, "soft_bubble")
    assert controller.session.alignment is None
    assert f"{OF_DIGIT.name} is of other sensors and not used" in notification(controller).text
    assert "Use it again" not in list_texts(notification(controller).buttons), (
        "this recording has no DIGIT"
    )
    controller.open_path(SAMPLE_RECORDING)
    assert wait_until_shown(controller, LIMIT_S)
    click(notification(controller).buttons, "Use it again")
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    used = controller.views.translation
    assert (used.source.name, used.target.name, used.request.alignment) == (
        "digit",
        "gelslim",
        OF_DIGIT,
    )
    controller.undo_stack.undo()
    controller.undo_stack.undo()
    assert wait_until_shown(controller, LIMIT_S), "the opening is one step"
    controller.undo_stack.undo()
    assert wait_until_shown(controller, LIMIT_S)
    assert (controller.session.recording, controller.session.alignment) == (DIGIT, OF_DIGIT)


def test_another_target_drops_the_alignment_of_the_old_one(open_window):
    controller = open_window(GRASPS, target="soft_bubble", alignment=OF_GELSLIM)
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    controller.change("choose target", target="digit")
    assert wait_until_shown(controller, LIMIT_S)
    assert (controller.views.translation.target.name, controller.session.alignment) == (
        "digit",
        None,
    )
    click(notification(controller).buttons, "Use it again")
    assert wait_until_shown(controller, LIMIT_S)
    assert controller.views.translation.request.alignment == OF_GELSLIM


def test_the_banner_goes_on_without_the_alignment_or_with_its_target(open_window):
    controller = open_window(GRASPS, target="digit", alignment=OF_GELSLIM)
    assert not wait_until_shown(controller, LIMIT_S)
    banner = controller.window.banner
    assert list_texts(banner.buttons) == ["Target Soft Bubble", "Without this alignment"]
    click(banner.buttons, "Without this alignment")
    assert wait_until_shown(controller, LIMIT_S), banner.text
    assert (controller.session.alignment, controller.session.target) == (None, "digit")
    controller.open_path(OF_GELSLIM)
    assert not wait_until_shown(controller, LIMIT_S) or banner.isVisible()
    click(banner.buttons, "Target Soft Bubble")
    assert wait_until_shown(controller, LIMIT_S), banner.text
    assert (controller.session.alignment, controller.session.target) == (OF_GELSLIM, "soft_bubble")


def test_a_file_that_is_no_alignment_is_refused_before_it_locks_the_window(open_window, tmp_path):
    controller = open_window()
    bad = tmp_path / "bad.toml"
    bad.write_text('source = "digit"\n')
    controller.open_path(bad)
    assert controller.session.alignment is None
    assert "bad.toml" in controller.window.banner.text


def test_undo_of_the_first_opening_leaves_the_window_as_at_the_start(
    open_window, touch_file, qtbot
):
    controller = open_window()
    window = controller.window
    before = window.windowTitle(), window.source.currentText(), window.timeline.isEnabled()
    controller.open_path(touch_file)
    assert wait_until_shown(controller, LIMIT_S), window.banner.text
    controller.undo_stack.undo()
    assert (
        window.windowTitle(),
        window.source.currentText(),
        window.timeline.isEnabled(),
    ) == before
    assert all(column.view.preview is None for column in window.columns.values())
    assert controller.is_idle
    controller.findChild(FrameRankingController)._rank_next()  # what its timer does
    qtbot.waitUntil(lambda: not controller.job.is_busy, timeout=240_000)
    qtbot.wait(1)
    assert not window.banner.isVisible(), window.banner.text
    controller.undo_stack.redo()
    assert wait_until_shown(controller, LIMIT_S), window.banner.text


@pytest.mark.parametrize(
    ("before", "target"),
    [
        ("digit", "gelslim"),
        ("gelslim", "gelslim"),
        ("soft_bubble", "gelslim"),
    ],
)
def test_a_new_recording_chooses_its_own_target(open_window, touch_file, before, target):
    """Its second sensor, or for one sensor alone another kind."""
    controller = open_window(SAMPLE_RECORDING, source="gelslim", target=before)
    assert wait_until_shown(controller, LIMIT_S)
    controller.open_path(touch_file)
    assert wait_until_shown(controller, LIMIT_S)
    assert controller.views.translation.target.name == target
    bar = notification(controller)
    assert (not bar.isHidden() and "Target DIGIT" in list_texts(bar.buttons)) == (before == "digit")


def test_a_gel_alone_is_translated_to_a_bubble(tmp_path):
    from app.document.requests import open_request
    from pipeline.core.values.frames import TactileFrame
    from pipeline.io.hdf5_writer import RecordingWriter
    from pipeline.physics import optics
    from pipeline.sensors.spec import load_sensor
    from pipeline.translation.catalogue import BUILT_IN
    from pipeline.translation.translate import Request

    for name in ("digit", "gelslim", "gelsight_mini"):
        still = optics.render_reference(load_sensor(name))
        path = tmp_path / f"{name}.h5"
        with RecordingWriter(path) as writer:
            writer.append(
                "only", TactileFrame(sensor=name, image=still, reference=still, index=0, time_s=0.0)
            )
        opened = open_request(Request(recording=path, target=""), BUILT_IN)
        assert opened.target.name == "soft_bubble"
        opened.close()


def test_a_pinned_truth_ends_with_its_recording():
    pinned = Session(recording=GRASPS, methods={"depth": "truth", "touch": "physics"})
    assert pinned.with_updates(recording=SAMPLE_RECORDING).methods == {"touch": "physics"}
    assert pinned.with_updates(frame=2).methods == pinned.methods
    assert pinned.with_updates(recording=DIGIT, methods={"depth": "truth"}).methods == {
        "depth": "truth"
    }


def test_a_pinned_truth_is_marked_wherever_its_results_are_shown(open_window):
    controller = open_window(
        GRASPS,
        source="gelslim",
        target="soft_bubble",
        frame=1,
        methods={"depth": "truth", "touch": "physics"},
    )
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    window = controller.window
    depth = window.columns["depth"]
    touch = window.columns["touch"]
    assert "with true depth" in window.windowTitle()
    assert depth.state == "warning", "not a green 'read'"
    assert "border" in depth.styleSheet()
    assert "with true depth" in touch.view.remark.text()
    title = name_pane(
        controller.views.translation, "touch", controller.views.get_shown_stage("touch").result
    )
    assert title == "Soft Bubble, generated touch: Physical render, with true depth"
    click(depth.head.findChildren(QPushButton), "Unpin")
    assert wait_until_shown(controller, LIMIT_S)
    assert controller.session.methods == {"touch": "physics"}
    assert "with true" not in window.windowTitle() + touch.view.remark.text()
    assert not depth.styleSheet()


def test_the_title_of_a_method_that_did_not_answer_is_struck_out(open_window):
    controller = open_window(GRASPS, source="gelslim", target="soft_bubble", frame=1, route="t2d2")
    assert wait_until_shown(controller, LIMIT_S)
    parameters = controller.window.parameters
    params = controller.session.get_params
    touch = next(method for method in controller.methods if method.stage == "touch")

    def list_struck_out() -> list[str]:
        return [
            part.toolTip() for part in parameters.findChildren(QLabel) if part.font().strikeOut()
        ]

    assert not list_struck_out()
    controller.choose_params(touch.key, type(params(touch))(steps=0))
    assert wait_until_shown(controller, LIMIT_S)
    (reason,) = list_struck_out()
    assert "no denoising step" in reason
    controller.choose_params(touch.key, type(params(touch))(steps=1))
    assert wait_until_shown(controller, LIMIT_S)
    assert not list_struck_out()
