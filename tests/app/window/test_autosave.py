"""What is edited outlives a kill, what would be lost is asked about, and what was open is
remembered.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

import pytest
from PyQt6.QtCore import QRect
from PyQt6.QtWidgets import QMessageBox

from app.document.autosave import AUTOSAVE_DELAY_MS, AutosaveController
from app.main import show_window
from app.session import recovery
from app.session.file_fingerprints import describe_changed_files, fingerprint_files
from app.session.preferences import Preferences
from app.session.state import Session, load_session, save_session
from app.shell.tour import wait_until_shown
from app.window.main_window import DEFAULT_SIZE
from pipeline.core.digests import compute_fingerprint
from widgets.shell.welcome import WelcomePage

LIMIT_S = 240
_EDIT_AND_WAIT = """
import sys, time
from pathlib import Path
from app.main import prepare_environment
prepare_environment()
from app.main import make_application, show_window
from app.document import autosave
autosave.AUTOSAVE_DELAY_MS = 50
application = make_application()
from app.session.state import Session
from pipeline.sensors.alignment import Offsets
controller = show_window(Session(recording=Path(sys.argv[1]), target="gelslim", frame=2), with_scene=False)
controller.change("move", offsets=Offsets(translation_mm=(1.5, 0.0, 0.0)))
file = next(c for c in controller.children() if isinstance(c, autosave.AutosaveController)).recovery_file
end_s = time.monotonic() + 60
while time.monotonic() < end_s:
    application.processEvents()
    if file.path.exists():
        print("saved", flush=True)
        time.sleep(60)
"""


def find_autosave(controller) -> AutosaveController:
    return next(child for child in controller.children() if isinstance(child, AutosaveController))


def move(controller, mm: float = 1.5) -> None:
    from pipeline.sensors.alignment import Offsets

    controller.change("move the alignment", offsets=Offsets(translation_mm=(mm, 0.0, 0.0)))


def test_edits_of_a_killed_window_can_be_recovered(touch_file, qtbot, remembered_here):
    environment = {
        **os.environ,
        "XDG_STATE_HOME": str(remembered_here),
        "XDG_CONFIG_HOME": str(remembered_here),
    }
    with subprocess.Popen(
        [sys.executable, "-c", _EDIT_AND_WAIT, touch_file],
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    ) as other:
        assert other.stdout.readline() == "saved\n"
        # its window is still there
        assert recovery.find_recoverable_sessions(recovery.get_recovery_folder()) == ()
        other.send_signal(signal.SIGKILL)
    left = recovery.find_recoverable_sessions(recovery.get_recovery_folder())
    assert [one.session.offsets.translation_mm for one in left] == [(1.5, 0.0, 0.0)]
    controller = show_window(Session(), with_scene=False, restore=True)
    qtbot.addWidget(controller.window, before_close_func=lambda _: controller.close())
    keeping = find_autosave(controller)
    try:
        assert keeping.notification.isVisible()
        assert touch_file.name in keeping.notification.text
        keeping.notification.buttons[0].click()
        assert wait_until_shown(controller, LIMIT_S)
        assert controller.session.recording == touch_file
        assert controller.session.offsets.translation_mm == (1.5, 0.0, 0.0)
        assert not left[0].path.exists()
    finally:
        controller.close()
    assert recovery.find_recoverable_sessions(recovery.get_recovery_folder()) == ()  # closed well


def test_a_kill_loses_at_most_one_autosave_interval():
    assert AUTOSAVE_DELAY_MS <= 60_000


@pytest.mark.parametrize(("answer", "goes"), [("Discard", True), ("Cancel", False), ("Save", True)])
def test_closing_asks_before_edits_are_lost(bubble_window, tmp_path, monkeypatch, answer, goes):
    asked = []

    def says(*_args):
        asked.append(answer)
        return QMessageBox.StandardButton[answer]

    monkeypatch.setattr(QMessageBox, "question", says)
    monkeypatch.setattr(
        "PyQt6.QtWidgets.QFileDialog.getSaveFileName", lambda *_args: (str(tmp_path / "mine"), "")
    )
    assert not bubble_window.window.isWindowModified()
    move(bubble_window)
    assert bubble_window.window.isWindowModified()
    assert bubble_window.window.close() is goes
    assert asked == [answer]
    if answer == "Save":
        assert load_session(tmp_path / "mine.touch.json").offsets.translation_mm == (1.5, 0.0, 0.0)


def test_closing_asks_nothing_without_unsaved_changes(bubble_window, monkeypatch):
    monkeypatch.setattr(QMessageBox, "question", lambda *_args: pytest.fail("asked"))
    bubble_window.choose_frame(1)
    move(bubble_window)
    bubble_window.undo_stack.undo()
    assert bubble_window.window.close()


def test_notes_and_undoing_a_save_are_unsaved_changes(bubble_window, tmp_path):
    bubble_window.change("note", notes={1: "slipped"})
    assert bubble_window.window.isWindowModified()
    bubble_window.save_session(tmp_path / "a.touch.json")
    assert not bubble_window.window.isWindowModified()
    bubble_window.undo_stack.undo()
    assert bubble_window.window.isWindowModified(), "the file still has the note"


def test_a_pipe_in_a_session_is_never_opened(tmp_path):
    os.mkfifo(tmp_path / "w.safetensors")
    assert compute_fingerprint(tmp_path / "w.safetensors") == ""
    session = Session(target="gelslim", weights={"touch": tmp_path / "w.safetensors"})
    assert fingerprint_files(session) == {"weights.touch": ""}


def test_two_windows_on_one_session_lose_no_note(bubble_window, tmp_path):
    path = tmp_path / "a.touch.json"
    bubble_window.save_session(path)
    bubble_window.change("note", notes={1: "mine"})
    other = path.read_text().replace('"notes": {}', '"notes": {"2": "theirs"}')
    path.write_text(other)
    bubble_window.save_session(path)
    assert "nother window has saved this session" in bubble_window.window.banner.text
    assert path.read_text() == other
    assert bubble_window.window.isWindowModified()
    bubble_window.save_session(tmp_path / "b.touch.json")
    assert load_session(tmp_path / "b.touch.json").notes == {1: "mine"}


def test_a_session_reports_changed_files(bubble_window, touch_file, tmp_path):
    own = tmp_path / "own.h5"
    own.write_bytes(touch_file.read_bytes())
    bubble_window.open_path(own)
    assert wait_until_shown(bubble_window, LIMIT_S)
    path = tmp_path / "s.touch.json"
    bubble_window.save_session(path)
    assert describe_changed_files(path, load_session(path)) == ()
    own.write_bytes(touch_file.read_bytes() + b"more")
    bubble_window.open_session(path)
    assert "the recording has changed" in bubble_window.window.banner.text.lower()
    own.unlink()
    assert "is missing" in describe_changed_files(path, load_session(path))[0]


def test_the_welcome_page_lists_recent_files_and_closes_on_opening(open_window, touch_file, qtbot):
    open_one = open_window(touch_file, target="gelslim")
    assert wait_until_shown(open_one, LIMIT_S)
    assert Preferences().recent_files == (touch_file,)
    assert Preferences().last_folder == touch_file.parent
    empty = open_window()
    page = empty.window.findChild(WelcomePage)
    assert page.isVisible()
    assert page.recent.count() == 1
    page.recent.itemActivated.emit(page.recent.item(0))
    assert wait_until_shown(empty, LIMIT_S)
    assert empty.session.recording == touch_file
    assert page.isHidden()


def test_the_window_restores_its_geometry_on_the_screen(qtbot):
    first = show_window(Session(), with_scene=False, restore=True)
    first.window.setGeometry(QRect(40, 50, 700, 500))
    first.window.drawers.frames.show()
    qtbot.wait(1)  # the least width comes with the drawer
    width_px = first.window.width()
    first.window.close()
    first.close()
    second = show_window(Session(), with_scene=False, restore=True)
    try:
        assert second.window.width() == width_px < DEFAULT_SIZE.width()
        assert second.window.drawers.frames.isVisible()
        room = second.window.screen().availableGeometry()
        second.window.setGeometry(QRect(room.right() - 50, room.bottom() - 50, 700, 500))
    finally:
        second.window.close()
        second.close()
    third = show_window(Session(), with_scene=False, restore=True)
    try:
        assert room.contains(third.window.frameGeometry())
    finally:
        third.window.close()
        third.close()


def test_a_recovery_file_of_another_version_is_named_and_can_be_discarded(
    touch_file, qtbot, remembered_here
):
    folder = recovery.get_recovery_folder()
    folder.mkdir(parents=True)
    old = folder / "session-1-1.touch.json"
    save_session(Session(recording=touch_file), old, {})
    plain = json.loads(old.read_text())
    old.write_text(json.dumps({**plain, "tactoscope session": 1}))
    controller = show_window(Session(), with_scene=False, restore=True)
    qtbot.addWidget(controller.window, before_close_func=lambda _: controller.close())
    try:
        notification = find_autosave(controller).notification
        assert notification.isVisible()
        assert "version 1" in notification.text
        assert [button.text() for button in notification.buttons if button.isVisible()] == [
            "Discard"
        ]
        notification.buttons[0].click()
        assert not old.exists()
        assert not notification.isVisible()
    finally:
        controller.close()


def test_another_windows_notes_are_kept_whatever_the_spelling_of_the_file(bubble_window, tmp_path):
    path = tmp_path / "mine.touch.json"
    link = tmp_path / "link.touch.json"
    bubble_window.save_session(path)
    link.symlink_to(path)
    save_session(Session(notes={3: "of another window"}), path, {})
    for spelling in (path, link, tmp_path / "none" / ".." / path.name):
        (tmp_path / "none").mkdir(exist_ok=True)
        bubble_window.save_session(spelling)
        assert "Another window has saved" in bubble_window.window.banner.text
        assert load_session(path).notes == {3: "of another window"}
