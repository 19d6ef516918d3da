"""Nothing is lost: the session is kept while it is edited, offered again after a crash, and asked about on close."""

from __future__ import annotations

import contextlib
from dataclasses import replace

from PyQt6.QtCore import QByteArray, QObject
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QMenu, QMessageBox

from app.frame import dialogs
from app.frame.instrument import Instrument
from app.frame.logs import log
from app.session import recovery
from app.session.recovery import Kept, Left
from app.session.remembered import Remembered
from app.session.state import DISPLAY, Session
from app.work.jobs import LatestJob
from pipeline.base.errors import TouchError
from pipeline.base.text import plain
from pipeline.recordings.mounted import is_mounted
from pipeline.translation.translate import Translation
from widgets.looks import once
from widgets.offer import Offer

KEEP_AFTER_MS = 15_000  # from the first change that is not on disk yet: a kill costs no more than that
_Answer = QMessageBox.StandardButton
_MINUTE_S = 60.0


class Keeping(QObject):
    """Between the instrument and what outlives it: kept sessions, recent files, the window's place."""

    def __init__(self, instrument: Instrument) -> None:
        super().__init__(instrument)
        self._instrument, self.window = instrument, instrument.window
        self.remembered = Remembered()
        self.kept = Kept(recovery.own_folder())
        self._job = LatestJob("keeping", self)
        self._soon = once(self, KEEP_AFTER_MS, self.keep_now)
        self._left: Session | None = None  # what the next window is to offer
        self.offer = Offer("recovery_offer")
        self.window.add_strip(self.offer)
        self.recent = QMenu("Open recent", self.window)
        self.recent.aboutToShow.connect(self._list_recent)
        self.window.add_menu("File", self.recent, before="open_mesh")
        self._remembers_place = False
        self.window.may_close = self.may_close
        instrument.session_shown.connect(self._session_shown)
        instrument.job.delivered.connect(self._opened)
        instrument.closing.connect(self._close)
        instrument.ended_from_outside.connect(self._leave_behind)
        self._job.failed.connect(self._not_kept)

    @property
    def folder(self) -> str:
        """Where a file dialog begins."""
        return str(self.remembered.folder or "")

    @property
    def unsaved(self) -> bool:
        """Whether there is work in the session that no file holds: parameters, methods, notes, a moved alignment."""
        now, saved = _work(self._instrument.session), _work(self._instrument.saved)
        nothing = now == _work(Session()) and self._instrument.session_file is None  # a file that is kept may differ
        return now != saved and not nothing

    def keep_now(self) -> None:
        """Have the session written beside, in the background."""
        self._soon.stop()
        session = self._to_keep()
        self._job.submit(lambda _report: self.kept.write(session), interrupt=False)

    def _to_keep(self) -> Session:
        session = self._instrument.to_keep
        session = replace(session, frame=max(0, session.frame))  # one that is not open yet has no frame
        if session.recording is not None and is_mounted(session.recording):
            session = replace(session, recording=None)  # a sensor that is watched is not there after a crash
        return session

    def take_place(self) -> None:
        """Go where the last window was, on a screen that is there, and leave the place behind on close."""
        self._remembers_place = True
        place = self.remembered.place
        if place is not None:
            self.window.restoreGeometry(place[0])
            self.window.restoreState(place[1])
        self.window.stay_on_screen()

    def offer_recovery(self) -> None:
        """Offer the session of a window that was ended from outside, where there is one."""
        left = recovery.left_over(self.kept.path.parent)
        if left:
            self._offer(left[0])

    def may_close(self) -> bool:
        """Whether the window may go: asks where work would be lost."""
        if self._instrument.closed or not self.unsaved:
            return True
        answer = self.asked()
        if answer == _Answer.Save:
            self.save()
            return not self.unsaved
        return answer == _Answer.Discard

    def asked(self) -> QMessageBox.StandardButton:
        """What the user says to losing changes."""
        return QMessageBox.question(
            self.window, "Unsaved changes", "Save what was changed in this session?",
            _Answer.Save | _Answer.Discard | _Answer.Cancel, _Answer.Save,
        )  # fmt: skip

    def save(self) -> None:
        """Save where the session came from or was saved before, else ask where."""
        path = self._instrument.session_file or dialogs.to_save(self.window, "save_session", self.folder)
        if path is not None:
            self._instrument.save_session(path)

    def _offer(self, left: Left) -> None:
        def recover() -> None:
            self._instrument.push(left.session, "recover the session")
            self._instrument.turn(left.session.cameras)
            self._instrument.move_section(left.session.section)
            recovery.discard(left)
            self.keep_now()

        def discard() -> None:
            recovery.discard(left)
            self.offer_recovery()

        recording = left.session.recording
        of = "" if recording is None else f" of '{plain(recording.name)}'"
        self.offer.show_offer(
            f"a window was ended {_ago(left.age_s)} without being closed; its session{of} was kept",
            (("Recover", recover), ("Discard", discard)),
        )

    def _session_shown(self, session: Session) -> None:
        self.window.setWindowModified(self.unsaved)
        if session.recording is not None and not self._soon.isActive():
            self._soon.start()

    def _opened(self, _: int, part: object) -> None:
        if isinstance(part, Translation) and part.request.recording.exists():
            self.remembered.add_recent(part.request.recording)

    def _list_recent(self) -> None:
        self.recent.clear()
        for path in self.remembered.recent:
            action = QAction(plain(path.name), self.recent)
            action.setToolTip(plain(str(path)))
            action.triggered.connect(lambda _checked=False, path=path: self._instrument.open_path(path))
            self.recent.addAction(action)
        if self.recent.isEmpty():
            nothing = self.recent.addAction("nothing yet")
            assert nothing is not None
            nothing.setEnabled(False)
            return
        self.recent.addSeparator()
        forget = self.recent.addAction("Forget these")
        assert forget is not None
        forget.triggered.connect(self.remembered.forget_recent)

    def _not_kept(self, _: int, error: object) -> None:
        log.error("the session could not be kept: %s", error)

    def _leave_behind(self) -> None:
        self._left = self._to_keep() if self.unsaved else None

    def _close(self) -> None:
        self._soon.stop()
        self._job.close()
        if self._left is None:
            self.kept.forget()
        else:
            with contextlib.suppress(TouchError, OSError):  # nobody is there to be told, and the process must end
                self.kept.write(self._left)
        if self._remembers_place:
            self.remembered.place = (QByteArray(self.window.saveGeometry()), QByteArray(self.window.saveState()))
        self.remembered.write()


def _work(session: Session) -> Session:
    """What of a session took somebody's time; opening files again does not."""
    params = {key: value for key, value in session.params.items() if key != DISPLAY}
    return replace(
        Session(), params=params, methods=session.methods, offsets=session.offsets, notes=session.notes
    )  # fmt: skip


def _ago(age_s: float) -> str:
    for unit, seconds in (("day", 24 * 60 * _MINUTE_S), ("hour", 60 * _MINUTE_S), ("minute", _MINUTE_S)):
        count = round(age_s / seconds)
        if count >= 1:
            return f"{count} {unit}{'s' if count > 1 else ''} ago"
    return "a moment ago"
