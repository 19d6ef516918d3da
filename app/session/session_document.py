"""Opening and saving: what a path is, and what becomes of the session."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PyQt6.QtCore import QObject, pyqtSignal
from PyQt6.QtGui import QUndoStack

from app.session.file_fingerprints import describe_changed_files, fingerprint_files
from app.session.state import AUTO_FRAME, SESSION_SUFFIX, Session, load_session, save_session
from app.session.undo import MAX_STEPS, SessionChange
from app.window import dialogs
from app.window.logs import describe_error, log
from app.window.main_window import MainWindow
from app.window.screenshots import write_screenshot
from pipeline.base.errors import TouchError
from pipeline.calibration.calibration_file import is_calibration_file as is_calibration
from pipeline.translation.cross_section import SectionLine


class SessionDocument(QObject):
    """Holds the session and its undo stack; knows how it changes, by files too, but not how it is shown."""

    section_changed = pyqtSignal(object)  # Line or None

    def __init__(self, window: MainWindow, session: Session) -> None:
        super().__init__(window)
        self.window, self.session, self.undo_stack = window, session, QUndoStack(self)
        self.undo_stack.setUndoLimit(MAX_STEPS)
        self.saved_session = session  # as it was saved or opened last
        self.session_file: Path | None = None  # where
        self.section: SectionLine | None = None  # that is laid through all pictures

    @abstractmethod
    def show_session(self, session: Session) -> None:
        """Show a session: controls at once, stages when the background has them."""

    def set_section(self, line: SectionLine | None) -> None:
        """Lay the section's line elsewhere, or take it away: like turning a view, no step to be undone."""
        if line != self.section:
            self.section = line
            self.section_changed.emit(line)

    @property
    @abstractmethod
    def session_to_save(self) -> Session:
        """The session with what is no change of it: where the 3D views look, and the section's line."""

    @abstractmethod
    def set_cameras(self, cameras: Mapping[str, tuple[float, ...]]) -> None:
        """Have the 3D views look so."""

    def change(self, text: str, *, key: str = "", **updates: Any) -> None:
        """Change the session as one undo step; following changes of the same `key` join it."""
        new = self.session.with_updates(**updates)
        if new != self.session:
            self.push_session(new, text, key)

    def push_session(self, new: Session, text: str, key: str = "") -> None:
        """Go to another session as one undo step; see `change`."""
        self.undo_stack.push(SessionChange(old=self.session, new=new, text=text, key=key, show=self.show_session))

    def show_problem(self, error: BaseException) -> None:
        """Say in the banner what went wrong, and log it once."""
        sentence, details = describe_error(error)
        log.error("%s", sentence)
        self.window.banner.show_problem(sentence, details)

    def open_path(self, path: Path) -> None:
        """Open whatever `path` is: a session, a mesh, a calibration or a recording."""
        if path.name.endswith(SESSION_SUFFIX):
            self.open_session(path)
        elif path.suffix.lower() in dialogs.MESH_SUFFIXES:
            self.open_mesh(path)
        elif path.suffix.lower() == dialogs.ALIGNMENT_SUFFIX:
            self.change("open alignment", alignment=path)
        elif path.suffix.lower() == dialogs.WEIGHTS_SUFFIX:
            self.open_weights(path)
        elif is_calibration(path):
            self.change("open calibration", calibration=path)
        else:
            self.change(
                "open recording", recording=path, frame=AUTO_FRAME, source="", stream="", reference=None,
                calibration=None, mesh=None, mesh_unit="auto", depth_unit="auto",
            )  # fmt: skip

    def open_paths(self, paths: list[Path]) -> None:
        """Open what was dropped: recordings first, then what goes with them."""
        for path in sorted(paths, key=lambda p: p.suffix.lower() in dialogs.MESH_SUFFIXES or is_calibration(p)):
            self.open_path(path)

    def open_mesh(self, path: Path | None, unit: str = "auto") -> None:
        """Open the touched object's mesh, whose numbers are in `unit`; None goes back to the recording's own."""
        self.change("close mesh" if path is None else "open mesh", mesh=path, mesh_unit=unit)

    def open_weights(self, path: Path | None) -> None:
        """Open a network's weights, for the first method that takes such; None goes back to those that come along."""
        self.change("close weights" if path is None else "open weights", weights={} if path is None else {"": path})

    def open_reference(self, path: Path) -> None:
        """Open the image of the untouched sensor."""
        self.change("open reference", reference=path)

    def open_session(self, path: Path) -> None:
        """Replace everything by what a session file says."""
        with self._told():
            opened = load_session(path)
            self.saved_session, self.session_file = opened, path
            self.push_session(opened, "open session")
            self.set_cameras(opened.cameras)
            self.set_section(opened.section)
            for sentence in describe_changed_files(path, opened):
                log.warning("%s", sentence)
                self.window.banner.show_problem(sentence)

    def save_session(self, path: Path) -> None:
        """Write the session file."""
        with self._told():
            save_session(self.session_to_save, path, fingerprint_files(self.session))
            self.saved_session, self.session_file = self.session, path
            self.undo_stack.setClean()
            self.window.setWindowModified(False)
            log.info("session saved: '%s'", path)

    def save_screenshot(self, path: Path) -> None:
        """Write a picture of the window."""
        with self._told():
            write_screenshot(self.window, path)

    @contextmanager
    def _told(self) -> Generator[None]:
        """Errors that are the user's to mend end in the banner."""
        try:
            yield
        except TouchError as error:
            self.show_problem(error)
