"""The session as a document: changing it, undoing, opening files and saving."""

import os
from abc import abstractmethod
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from PyQt6.QtCore import QObject, pyqtSignal
from PyQt6.QtGui import QUndoStack

from app.session.file_fingerprints import describe_changed_files, fingerprint_files
from app.session.layout import Layout
from app.session.state import (
    AUTO_FRAME,
    SESSION_SUFFIX,
    Session,
    describe_removed_params,
    load_session,
    save_session,
)
from app.session.undo import MAX_UNDO_STEPS, SessionChange
from app.window import dialogs
from app.window.logs import describe_error, log
from app.window.main_window import MainWindow
from app.window.screenshots import write_screenshot
from pipeline.calibration.calibration_file import is_calibration_file
from pipeline.core.digests import compute_fingerprint
from pipeline.core.errors import FileProblem, TouchError
from pipeline.lab.tasks.trial_rows import is_rollout_folder
from pipeline.lab.tracking.track_record import is_track_folder
from pipeline.sensors.alignment import read_alignment
from pipeline.sensors.descriptions import is_description
from pipeline.translation.cross_section import SectionLine
from pipeline.translation.reports.folder_overview import list_recordings
from widgets.style.notification_bar import Choice

_AS_RECORDED: Mapping[str, Any] = {
    "source": "",
    "target": "",
    "stream": "",
    "reference": None,
    "reference_frames": "",
    "calibration": None,
    "mesh": None,
    "mesh_unit": "auto",
    "depth_unit": "auto",
}


class SessionDocument(QObject):
    """Holds the session, its undo stack and its file; subclasses show it."""

    section_changed = pyqtSignal(object)  # SectionLine or None
    tick_changed = pyqtSignal(int)  # of the rollout in the Task layout
    recording_opened = pyqtSignal(Path)  # by the user
    rollouts_requested = pyqtSignal(Path)  # a folder that may hold rollouts
    folder_requested = pyqtSignal(Path, tuple)  # a folder, and the recordings in it
    tracks_requested = pyqtSignal(Path)  # a folder that holds a track

    def __init__(self, window: MainWindow, session: Session) -> None:
        super().__init__(window)
        self.window, self.session, self.undo_stack = window, session, QUndoStack(self)
        self.undo_stack.setUndoLimit(MAX_UNDO_STEPS)
        self.saved_session = session  # as last saved or opened
        self.session_file: Path | None = None
        self._file_fingerprint = ""  # of the session file as this window left it
        self.section: SectionLine | None = None  # section line through all images
        self.previous_target = ""  # of the recording before
        self.tick = 0  # of the rollout in the Task layout
        # buttons that mend an error
        self.find_remedies: Callable[[BaseException], Sequence[Choice]] = lambda _: ()

    @abstractmethod
    def show_session(self, session: Session) -> None:
        """Show a session: controls at once, stages when they are computed."""

    @property
    @abstractmethod
    def session_to_save(self) -> Session:
        """The session with the current 3D cameras and section line."""

    @abstractmethod
    def set_cameras(self, cameras: Mapping[str, tuple[float, ...]]) -> None:
        """Set the cameras of the 3D views."""

    def set_section(self, line: SectionLine | None) -> None:
        """Move the section line, or remove it (None); not an undo step."""
        if line != self.section:
            self.section = line
            self.section_changed.emit(line)

    def set_tick(self, tick: int) -> None:
        """Go to a tick of the rollout; not an undo step."""
        if tick != self.tick:
            self.tick = tick
            self.tick_changed.emit(tick)

    def change(self, text: str, *, key: str = "", **updates: Any) -> None:
        """Change fields of the session as one undo step.

        Consecutive changes with the same `key` merge.
        """
        new = self.session.with_updates(**updates)
        if new != self.session:
            self.push_session(new, text, key)

    def push_session(self, new: Session, text: str, key: str = "") -> None:
        """Replace the session as one undo step; see `change`."""
        self.undo_stack.push(
            SessionChange(old=self.session, new=new, text=text, key=key, show=self.show_session)
        )

    def restore_session(self, session: Session, text: str) -> None:
        """Replace the session, with its cameras and section line, as one undo step; the device
        stays.
        """
        self.push_session(session.with_device(self.session.device), text)
        self.set_cameras(session.cameras)
        self.set_section(session.section)
        self.set_tick(session.tick)

    def show_problem(self, error: BaseException) -> None:
        """Show an error in the banner, and log it once."""
        sentence, details = describe_error(error)
        log.error("%s", sentence)
        self.window.banner.show_problem(sentence, details, self.find_remedies(error))

    def open_path(self, path: Path) -> None:
        """Open a session, mesh, source sensor, alignment, weights, calibration or recording,
        whichever `path` is.
        """
        suffix = path.suffix.lower()
        if path.name.endswith(SESSION_SUFFIX):
            self.open_session(path)
        elif suffix in dialogs.MESH_SUFFIXES:
            self.open_mesh(path)
        elif suffix == dialogs.ALIGNMENT_SUFFIX and is_description(path):
            self.change("choose source", source=str(path), stream="")
        elif suffix == dialogs.ALIGNMENT_SUFFIX:
            with self._problems_in_banner():
                read_alignment(path)
                self.change("open alignment", alignment=path)
        elif suffix == dialogs.WEIGHTS_SUFFIX:
            self.open_weights(path)
        elif is_calibration_file(path):
            self.change("open calibration", calibration=path)
        elif is_track_folder(path):
            self.tracks_requested.emit(path)
        elif is_rollout_folder(path):
            self.rollouts_requested.emit(path)
        else:
            self.open_data(path)

    def open_data(self, path: Path) -> None:
        """Open a recording, or the table of a folder that holds several."""
        if recordings := list_recordings(path):
            self.folder_requested.emit(path, recordings)
        else:
            self.open_recording(path, keeps_choices=self.session.recording is None)

    def open_recording(self, path: Path, *, keeps_choices: bool = False) -> None:
        """Open a recording; with `keeps_choices` its sensor and the files that go with it are
        those chosen before.
        """
        own = {} if keeps_choices else dict(_AS_RECORDED)
        self.previous_target = self.session.target
        if self.session.layout.name == "folder":
            own["layout"] = replace(self.session.layout, name="look")
        self.change("open recording", key=f"open {path}", recording=path, frame=AUTO_FRAME, **own)
        self.recording_opened.emit(path)

    def open_trial(self, path: Path, fields: Mapping[str, Any], layout: Layout) -> None:
        """Open a rollout of a task with the `fields` that translate it as its controller did."""
        own = {**_AS_RECORDED, "alignment": None, "layout": layout, **fields}
        self.change("open trial", key=f"open {path}", recording=path, frame=0, **own)

    def open_paths(self, paths: list[Path]) -> None:
        """Open dropped files: recordings first, then meshes and calibrations for them."""
        for path in sorted(
            paths, key=lambda p: p.suffix.lower() in dialogs.MESH_SUFFIXES or is_calibration_file(p)
        ):
            self.open_path(path)

    def open_mesh(self, path: Path | None, unit: str = "auto") -> None:
        """Open the mesh of the touched object, in `unit`.

        None returns to the recording's own mesh.
        """
        self.change("close mesh" if path is None else "open mesh", mesh=path, mesh_unit=unit)

    def open_weights(self, path: Path | None) -> None:
        """Open weights for the first stage whose method reads weights.

        None returns to the shipped weights.
        """
        self.change(
            "close weights" if path is None else "open weights",
            weights={} if path is None else {"": path},
        )

    def open_reference(self, path: Path) -> None:
        """Open the reference image of the source sensor."""
        self.change("open reference", reference=path, reference_frames="")

    def choose_reference_frames(self, frames: str) -> None:
        """Make the reference of the source sensor of these frames; "" = as recorded."""
        self.change("choose reference", reference=None, reference_frames=frames)

    def open_session(self, path: Path) -> None:
        """Open a session file, and warn of files that changed since it was saved."""
        with self._problems_in_banner():
            opened = load_session(path)
            self.saved_session = opened
            self.session_file = path
            self._file_fingerprint = compute_fingerprint(path)
            self.restore_session(opened, "open session")
            changed = describe_changed_files(path, opened)
            for sentence in (*describe_removed_params(path), *changed):
                log.warning("%s", sentence)
                self.window.banner.show_problem(sentence)

    def save_session(self, path: Path) -> None:
        """Write the session file; refused where another window or program has changed it
        meanwhile.
        """
        with self._problems_in_banner():
            if self._is_session_file(path) and compute_fingerprint(path) not in (
                self._file_fingerprint,
                "",
            ):
                raise FileProblem(
                    "another window has saved this session meanwhile; save yours under another "
                    "name, or open it again",
                    path,
                )
            save_session(self.session_to_save, path, fingerprint_files(self.session))
            self.saved_session = self.session
            self.session_file = path
            self._file_fingerprint = compute_fingerprint(path)
            self.undo_stack.setClean()
            self.window.setWindowModified(False)
            log.info("session saved: '%s'", path)
            self.window.say(f"saved as {path.name}")

    def _is_session_file(self, path: Path) -> bool:
        """Whether a path is that of the open session's file, by whatever spelling."""
        return self.session_file is not None and os.path.realpath(path) == os.path.realpath(
            self.session_file
        )

    def save_screenshot(self, path: Path) -> None:
        """Write an image of the window."""
        with self._problems_in_banner():
            write_screenshot(self.window, path)

    @contextmanager
    def _problems_in_banner(self) -> Generator[None]:
        try:
            yield
        except TouchError as error:
            self.show_problem(error)
