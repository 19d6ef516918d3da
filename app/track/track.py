"""The *Track* layout: follows the object through the recording, opens a track from its folder,
and writes it.
"""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from app.compare.variant_jobs import list_set_options
from app.document.autosave import AutosaveController
from app.document.background_controller import BackgroundController
from app.document.requests import make_request
from app.document.session_controller import SessionController
from app.export.export import ExportController
from app.session.state import Session
from app.window import dialogs
from app.window.jobs import JobReporter
from pipeline.lab.tracking.track_record import TRACKED_STAGES, TrackRow, write_record
from pipeline.translation.reports.export_request import format_options
from pipeline.views.view import to_xyz

if TYPE_CHECKING:
    from app.track.track_jobs import TrackView

_NO_RECORDING = "Open a recording to follow the touched object through it, or open a track."
_READY = (
    "Track follows the touched object from frame to frame, without its mesh, and fuses what "
    "was touched."
)


class TrackController(BackgroundController):
    """Connects the page with the session; a track runs on its own copy of the recording."""

    def __init__(
        self, controller: SessionController, export: ExportController, autosave: AutosaveController
    ) -> None:
        super().__init__("track", controller, controller.window.track.run_bar)
        self._page = self._window.track
        self._export = export
        self.view: TrackView | None = None
        # what the track on screen was computed from; None = read from a folder
        self._tracked: Session | None = None
        self._of: Path | None = None  # recording, or the folder that is read
        self._beside: Path | None = None  # recording that was open then
        page = self._page
        window = self._window
        page.run_bar.start_button.clicked.connect(lambda: self.start_track(page.stage_box.choice))
        page.plot.step_chosen.connect(self._choose_row)
        controller.tracks_requested.connect(self.open_track)
        window.connect_command("cancel", self.cancel)
        autosave.connect_dialog("export_track", dialogs.ask_save_path, self.write_track)
        self._show_none(_NO_RECORDING)

    def start_track(self, stage: str) -> None:
        """Follow the membrane of a stage through the session's recording."""
        session = self._session
        catalogue = self._controller.catalogue
        if session.recording is None or not stage:
            return

        def work(report: JobReporter) -> TrackView:
            from app.track.track_jobs import track_session

            return track_session(session, stage, catalogue, report)

        self._tracked = session
        self._of = session.recording
        self._beside = session.recording
        self._show_none("")
        self.start(work)

    def open_track(self, folder: Path) -> None:
        """Show the track in a folder."""

        def work(_: JobReporter) -> TrackView:
            from app.track.track_jobs import read_track

            return read_track(folder)

        layout = replace(self._session.layout, name="track")
        self._change("open track", layout=layout)
        self._tracked, self._of, self._beside = None, folder, self._session.recording
        self._show_none(f"reading {folder.name}")
        self.start(work)

    def write_track(self, folder: Path) -> None:
        """Write the track on screen into a folder, as `tactoscope track` does."""
        view = self.view
        session = self._tracked
        if view is None or session is None:
            return
        record = view.record
        options = format_options(replace(make_request(session), offsets=session.offsets))
        settings = list_set_options(session.collect_params(self._controller.methods))
        words = ["tactoscope", "track", *options, "--stage", record.stage, *settings]
        command = f"{shlex.join(words)} --out {dialogs.quote_path(folder)}"
        self._export.start_writing(
            f"writing {folder.name}", lambda _: write_record(folder, record), folder, command
        )

    def show_session(self) -> None:
        """Drop the track of another recording, offer what can be followed, and mark the current
        frame.
        """
        session = self._session
        if self._of is not None and session.recording != self._beside:
            self.abandon()
            self._tracked = self._of = None
            self._show_none(_READY if session.recording is not None else _NO_RECORDING)
        elif self._of is None and session.recording is not None:
            self._show_none(_READY)
        self._offer_stages(session)
        self._show_frame()

    def show_part(self, part: object) -> None:
        """Show the frames so far."""
        self._page.plot.show_track(cast("tuple[TrackRow, ...]", part), ())

    def show_result(self, result: object) -> None:
        """Show the track with its surface."""
        self.view = view = cast("TrackView", result)
        self._page.show_record(view.record, self._of.name if self._of is not None else "")
        self._views.show_page_scene("track", view.layers, view.bounds, self._session)
        self._actions["export_track"].setEnabled(self._tracked is not None)
        self._show_frame()

    def show_failure(self, error: BaseException) -> None:  # noqa: ARG002 - the banner shows it
        """Show why there is no track."""
        self._show_none("")

    def show_cancelled(self) -> None:
        """Show that the run was cancelled."""
        self._show_none("cancelled")

    def show_frame(self) -> None:
        """Mark it on the track."""
        self._offer_stages(self._session)
        self._show_frame()

    def _offer_stages(self, session: Session) -> None:
        opened = self._translation
        stages = () if opened is None or session.recording is None else opened.stages
        offered = {name: title for name, title in TRACKED_STAGES.items() if name in stages}
        self._page.offer_stages(offered)
        can_track = bool(offered) and opened is not None and opened.n_frames > 1
        self._window.offer_layout("track", offered=can_track or self.view is not None)
        is_shown = session.layout.name == "track" and self._of is None
        if can_track and is_shown and opened is not None and opened.recording.refresh is None:
            self.start_track(self._page.stage_box.choice)

    def _show_none(self, text: str) -> None:
        self.view = None
        self._page.clear(text)
        self._views.show_page_scene("track", (), None, self._session)
        self._actions["export_track"].setEnabled(False)

    def _choose_row(self, row: int) -> None:
        if self.view is not None and self._tracked is not None:
            self._controller.choose_frame(self.view.record.rows[row].frame)
        elif self.view is not None:
            self._mark_row(row)

    def _show_frame(self) -> None:
        if self.view is not None and self._tracked is not None:
            frames = [row.frame for row in self.view.record.rows]
            frame = self._session.frame
            self._mark_row(frames.index(frame) if frame in frames else -1)

    def _mark_row(self, row: int) -> None:
        self._page.plot.show_step(row)
        path = np.zeros((0, 3)) if self.view is None else self.view.path_mm
        is_known = 0 <= row < len(path) and np.isfinite(path[row]).all()
        views = self._views
        views.scene.mark_point(views.places["track"], to_xyz(path[row]) if is_known else None)
