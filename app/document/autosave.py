"""Autosave, recovery after a crash, the question before closing, recent files and window
geometry.
"""

import contextlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeVar

from PyQt6.QtWidgets import QMenu, QMessageBox, QWidget

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.session import recovery
from app.session.preferences import Preferences
from app.session.recovery import RecoverableSession, RecoveryFile
from app.session.state import DISPLAY_KEY, Session
from app.window import dialogs
from app.window.jobs import LatestJob
from app.window.logs import log
from pipeline.core.errors import TouchError, escape_text
from pipeline.io.mounts import is_mounted
from widgets.style.notification_bar import Choice, NotificationBar
from widgets.style.styling import make_single_shot_timer

AUTOSAVE_DELAY_MS = 15_000  # from the first unsaved change: the most that a crash loses
_Answer = QMessageBox.StandardButton
T = TypeVar("T")


class AutosaveController(Feature):
    """Connects the session with everything that outlives the window."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self.preferences = Preferences()
        self.recovery_file = RecoveryFile(recovery.get_recovery_folder())
        self._job = LatestJob("autosave", self)
        self._timer = make_single_shot_timer(self, AUTOSAVE_DELAY_MS, self.autosave_now)
        self._to_recover: Session | None = None  # that the next window offers
        self.notification = NotificationBar("recovery_notification")
        self._window.add_notification(self.notification)
        self.recent_menu = QMenu("Open recent", self._window)
        self.recent_menu.aboutToShow.connect(self._fill_recent_menu)
        self._window.menus["File"].insertMenu(self._actions["open_mesh"], self.recent_menu)
        self._saves_geometry = False
        self._window.may_close = self.may_close
        controller.termination_requested.connect(self._prepare_recovery)
        self._job.failed.connect(self._show_failure)

    @property
    def dialog_folder(self) -> str:
        """Folder that file dialogs start in."""
        return str(self.preferences.last_folder or "")

    def connect_dialog(
        self,
        command: str,
        ask: Callable[[QWidget, str, str], T | None],
        then: Callable[[T], object],
    ) -> None:
        """Let a command ask for a file or folder, and call `then` with the answer, if any."""

        def ask_and_apply() -> None:
            answer = ask(self._window, command, self.dialog_folder)
            if answer is not None:
                then(answer)

        self._window.connect_command(command, ask_and_apply)

    @property
    def has_unsaved_changes(self) -> bool:
        """Whether parameters, methods, notes or offsets are not in the session file."""
        current = _get_work(self._session)
        saved = _get_work(self._controller.saved_session)
        is_default = current == _get_work(Session()) and self._controller.session_file is None
        return current != saved and not is_default

    def autosave_now(self) -> None:
        """Write the recovery file in the background."""
        self._timer.stop()
        session = self._session_to_write()
        self._job.submit(lambda _report: self.recovery_file.write(session), interrupt=False)

    def _session_to_write(self) -> Session:
        session = self._controller.session_to_save
        session = replace(session, frame=max(0, session.frame))  # not AUTO_FRAME
        if session.recording is not None and is_mounted(session.recording):
            session = replace(session, recording=None)  # a live source is gone after a crash
        return session

    def restore_geometry(self) -> None:
        """Restore the geometry of the last window, and save it on close."""
        self._saves_geometry = True
        if kept := self.preferences.window_geometry:
            self._window.restoreGeometry(kept[0])
            self._window.restoreState(kept[1])
        else:
            self._window.maximize_if_tight()

    def offer_recovery(self) -> None:
        """Offer the newest session of a window that did not close normally, if any."""
        sessions = recovery.find_recoverable_sessions(self.recovery_file.path.parent)
        if sessions:
            self._offer(sessions[0])

    def may_close(self) -> bool:
        """Return whether the window may close; asks if changes are unsaved."""
        if self._controller.is_closed or not self.has_unsaved_changes:
            return True
        answer = self.ask_to_save()
        if answer == _Answer.Save:
            self.save_session()
            return not self.has_unsaved_changes
        return answer == _Answer.Discard

    def ask_to_save(self) -> QMessageBox.StandardButton:
        """Ask whether to save, discard or cancel."""
        return QMessageBox.question(
            self._window,
            "Unsaved changes",
            "Save the changes of this session?",
            _Answer.Save | _Answer.Discard | _Answer.Cancel,
            _Answer.Save,
        )

    def save_session(self) -> None:
        """Save to the session's file; ask for one if it has none."""
        path = self._controller.session_file or dialogs.ask_save_path(
            self._window, "save_session", self.dialog_folder
        )
        if path is not None:
            self._controller.save_session(path)

    def _offer(self, recoverable: RecoverableSession) -> None:
        session = recoverable.session

        def recover() -> None:
            assert session is not None
            self._controller.restore_session(session, "recover session")
            recovery.remove_recovery_file(recoverable.path)
            self.autosave_now()

        def discard() -> None:
            recovery.remove_recovery_file(recoverable.path)
            self.offer_recovery()

        choices: list[Choice] = [("Discard", discard)]
        if session is None:
            what = f"Its session cannot be recovered: {recoverable.problem}"
        else:
            of = "" if session.recording is None else f" of '{escape_text(session.recording.name)}'"
            what = f"Its session{of} can be recovered."
            choices.insert(0, ("Recover", recover))
        since = f"A window did not close normally {_format_age(recoverable.age_s)}."
        self.notification.show_notification(f"{since} {what}", choices, stays=True)

    def show_session(self) -> None:
        """Mark unsaved changes in the title, and schedule an autosave."""
        self._window.setWindowModified(self.has_unsaved_changes)
        if self._session.recording is not None and not self._timer.isActive():
            self._timer.start()

    def show_translation(self) -> None:
        """Remember the recording as a recent file, unless it is live."""
        recording = self._session.recording
        if recording is not None and recording.exists():
            self.preferences.add_recent(recording)

    def _fill_recent_menu(self) -> None:
        self.recent_menu.clear()
        for path in self.preferences.recent_files:
            self.recent_menu.addAction(
                escape_text(path.name), partial(self._controller.open_path, path)
            )
        self.recent_menu.addSeparator()
        self.recent_menu.addAction("Clear list", self.preferences.clear_recent)

    def _show_failure(self, _: int, error: object) -> None:
        log.error("autosave failed: %s", error)

    def _prepare_recovery(self) -> None:
        self._to_recover = self._session_to_write() if self.has_unsaved_changes else None

    def close(self) -> None:
        """Write what the next window needs."""
        self._job.close()
        if self._to_recover is None:
            recovery.remove_recovery_file(self.recovery_file.path)
        else:
            # the process is ending: no one can act on an error
            with contextlib.suppress(TouchError, OSError):
                self.recovery_file.write(self._to_recover)
        self.recovery_file.unlock()
        if self._saves_geometry:
            window = self._window
            self.preferences.window_geometry = window.saveGeometry(), window.saveState()
        self.preferences.sync()


def _get_work(session: Session) -> Session:
    """Return only what counts as unsaved work; opened files do not."""
    params = {key: value for key, value in session.params.items() if key != DISPLAY_KEY}
    work = {name: getattr(session, name) for name in ("methods", "offsets", "notes")}
    return Session(params=params, **work)


def _format_age(age_s: float) -> str:
    for unit, seconds in (("day", 86_400), ("hour", 3_600), ("minute", 60)):
        count = round(age_s / seconds)
        if count >= 1:
            return f"{count} {unit}{'s' if count > 1 else ''} ago"
    return "a moment ago"
