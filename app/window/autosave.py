"""Nothing is lost: the session is kept while it is edited, offered again after a crash, and asked about on close."""

from __future__ import annotations

import contextlib
from dataclasses import replace

from PyQt6.QtCore import QByteArray, QObject
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QMenu, QMessageBox

from app.session import recovery
from app.session.preferences import Preferences
from app.session.recovery import RecoverableSession, RecoveryFile
from app.session.state import DISPLAY_KEY, Session
from app.window import dialogs
from app.window.logs import log
from app.window.session_controller import SessionController
from app.work.jobs import LatestJob
from pipeline.base.errors import TouchError
from pipeline.base.text import escape_text
from pipeline.recordings.mounts import is_mounted
from pipeline.translation.translate import Translation
from widgets.notification_bar import NotificationBar
from widgets.styling import make_single_shot_timer

AUTOSAVE_DELAY_MS = 15_000  # from the first change that is not on disk yet: a kill costs no more than that
_Answer = QMessageBox.StandardButton
_MINUTE_S = 60.0


class AutosaveController(QObject):
    """Between the controller and what outlives it: kept sessions, recent files, the window's place."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller, self.window = controller, controller.window
        self.preferences = Preferences()
        self.recovery_file = RecoveryFile(recovery.get_recovery_folder())
        self._job = LatestJob("keeping", self)
        self._soon = make_single_shot_timer(self, AUTOSAVE_DELAY_MS, self.autosave_now)
        self._left: Session | None = None  # what the next window is to offer
        self.notification = NotificationBar("recovery_notification")
        self.window.add_strip(self.notification)
        self.recent_menu = QMenu("Open recent", self.window)
        self.recent_menu.aboutToShow.connect(self._list_recent)
        self.window.add_menu("File", self.recent_menu, before="open_mesh")
        self._remembers_place = False
        self.window.may_close = self.may_close
        controller.session_shown.connect(self._session_shown)
        controller.job.delivered.connect(self._opened)
        controller.closing.connect(self._close)
        controller.termination_requested.connect(self._leave_behind)
        self._job.failed.connect(self._not_kept)

    @property
    def dialog_folder(self) -> str:
        """Where a file dialog begins."""
        return str(self.preferences.last_folder or "")

    @property
    def has_unsaved_changes(self) -> bool:
        """Whether there is work in the session that no file holds: parameters, methods, notes, a moved alignment."""
        now, saved = _work(self._controller.session), _work(self._controller.saved_session)
        nothing = now == _work(Session()) and self._controller.session_file is None  # a file that is kept may differ
        return now != saved and not nothing

    def autosave_now(self) -> None:
        """Have the session written beside, in the background."""
        self._soon.stop()
        session = self._to_keep()
        self._job.submit(lambda _report: self.recovery_file.write(session), interrupt=False)

    def _to_keep(self) -> Session:
        session = self._controller.session_to_save
        session = replace(session, frame=max(0, session.frame))  # one that is not open yet has no frame
        if session.recording is not None and is_mounted(session.recording):
            session = replace(session, recording=None)  # a sensor that is watched is not there after a crash
        return session

    def restore_geometry(self) -> None:
        """Go where the last window was, on a screen that is there, and leave the place behind on close."""
        self._remembers_place = True
        place = self.preferences.window_geometry
        if place is not None:
            self.window.restoreGeometry(place[0])
            self.window.restoreState(place[1])
        self.window.stay_on_screen()

    def offer_recovery(self) -> None:
        """Offer the session of a window that was ended from outside, where there is one."""
        left = recovery.find_recoverable_sessions(self.recovery_file.path.parent)
        if left:
            self._offer(left[0])

    def may_close(self) -> bool:
        """Whether the window may go: asks where work would be lost."""
        if self._controller.is_closed or not self.has_unsaved_changes:
            return True
        answer = self.ask_to_save()
        if answer == _Answer.Save:
            self.save_session()
            return not self.has_unsaved_changes
        return answer == _Answer.Discard

    def ask_to_save(self) -> QMessageBox.StandardButton:
        """What the user says to losing changes."""
        return QMessageBox.question(
            self.window, "Unsaved changes", "Save what was changed in this session?",
            _Answer.Save | _Answer.Discard | _Answer.Cancel, _Answer.Save,
        )  # fmt: skip

    def save_session(self) -> None:
        """Save where the session came from or was saved before, else ask where."""
        path = self._controller.session_file or dialogs.ask_save_path(self.window, "save_session", self.dialog_folder)
        if path is not None:
            self._controller.save_session(path)

    def _offer(self, left: RecoverableSession) -> None:
        def recover() -> None:
            self._controller.push_session(left.session, "recover the session")
            self._controller.set_cameras(left.session.cameras)
            self._controller.set_section(left.session.section)
            recovery.discard_session(left)
            self.autosave_now()

        def discard() -> None:
            recovery.discard_session(left)
            self.offer_recovery()

        recording = left.session.recording
        of = "" if recording is None else f" of '{escape_text(recording.name)}'"
        self.notification.show_notification(
            f"a window was ended {_ago(left.age_s)} without being closed; its session{of} was kept",
            (("Recover", recover), ("Discard", discard)),
        )

    def _session_shown(self, session: Session) -> None:
        self.window.setWindowModified(self.has_unsaved_changes)
        if session.recording is not None and not self._soon.isActive():
            self._soon.start()

    def _opened(self, _: int, part: object) -> None:
        if isinstance(part, Translation) and part.request.recording.exists():
            self.preferences.add_recent(part.request.recording)

    def _list_recent(self) -> None:
        self.recent_menu.clear()
        for path in self.preferences.recent_files:
            action = QAction(escape_text(path.name), self.recent_menu)
            action.setToolTip(escape_text(str(path)))
            action.triggered.connect(lambda _checked=False, path=path: self._controller.open_path(path))
            self.recent_menu.addAction(action)
        if self.recent_menu.isEmpty():
            nothing = self.recent_menu.addAction("nothing yet")
            assert nothing is not None
            nothing.setEnabled(False)
            return
        self.recent_menu.addSeparator()
        forget = self.recent_menu.addAction("Forget these")
        assert forget is not None
        forget.triggered.connect(self.preferences.clear_recent)

    def _not_kept(self, _: int, error: object) -> None:
        log.error("the session could not be kept: %s", error)

    def _leave_behind(self) -> None:
        self._left = self._to_keep() if self.has_unsaved_changes else None

    def _close(self) -> None:
        self._soon.stop()
        self._job.close()
        if self._left is None:
            self.recovery_file.remove()
        else:
            with contextlib.suppress(TouchError, OSError):  # nobody is there to be told, and the process must end
                self.recovery_file.write(self._left)
        if self._remembers_place:
            self.preferences.window_geometry = (
                QByteArray(self.window.saveGeometry()),
                QByteArray(self.window.saveState()),
            )
        self.preferences.write()


def _work(session: Session) -> Session:
    """What of a session took somebody's time; opening files again does not."""
    params = {key: value for key, value in session.params.items() if key != DISPLAY_KEY}
    return replace(
        Session(), params=params, methods=session.methods, offsets=session.offsets, notes=session.notes
    )  # fmt: skip


def _ago(age_s: float) -> str:
    for unit, seconds in (("day", 24 * 60 * _MINUTE_S), ("hour", 60 * _MINUTE_S), ("minute", _MINUTE_S)):
        count = round(age_s / seconds)
        if count >= 1:
            return f"{count} {unit}{'s' if count > 1 else ''} ago"
    return "a moment ago"
