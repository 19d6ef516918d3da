"""Live source: read on its own thread.

The newest frame is shown when the stages are idle, and can be recorded.
"""

from pathlib import Path

from PyQt6.QtCore import QTimer
from PyQt6.QtWidgets import QFileDialog

from app.document.autosave import AutosaveController
from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.window import dialogs
from pipeline.core.errors import TouchError
from pipeline.io.live.paired_reader import PairedReader, make_reader
from pipeline.io.live.reader import LiveReader, ReaderStatus
from pipeline.io.live.recorder import LiveRecorder
from pipeline.io.live.source import LiveSource
from pipeline.io.live.source_parsing import parse_sources
from pipeline.io.live.usb_camera import list_usb_cameras
from pipeline.io.mounts import mount, unmount
from pipeline.physics.simulation import shapes
from pipeline.sensors.spec import list_sensor_titles, load_sensor
from pipeline.views.preview import make_recorded_preview
from widgets.live.live_dialog import LiveBar, LiveDialog

_UPDATE_MS = 33
_STOP_TIMEOUT_S = 1.0  # for the reader's thread on close; a camera that hangs is abandoned
_RECORDER_TIMEOUT_S = 5.0  # for the last frames of a recording to be written on close


class LiveController(Feature):
    """Connects a live reader with the session; never waits for a sensor or a disk."""

    def __init__(self, controller: SessionController, autosave: AutosaveController) -> None:
        super().__init__(controller)
        self._autosave = autosave
        self.live_bar, self.dialog = LiveBar(), LiveDialog(self._window)
        self._window.strips.addWidget(self.live_bar)
        self.dialog.show_choices(list_sensor_titles(), shapes.list_shapes())
        self.reader: LiveReader | None = None
        self.recorder: LiveRecorder | None = None
        self.is_following = False
        self._n_watched = 0
        self._shown_text = ""
        self._shown_partner = -1  # frame whose partner is on the bar
        self._path = self._opened = Path()  # of the live source, and of the one opened last
        self._timer = QTimer(self)
        self._timer.setInterval(_UPDATE_MS)
        self._timer.timeout.connect(self._update)
        self._window.connect_command("live", self.show_dialog)
        self.dialog.watch_requested.connect(self._watch_described)
        self.dialog.search_button.clicked.connect(self._list_cameras)
        self.dialog.browse_button.clicked.connect(self._ask_folder)
        self.live_bar.zero.clicked.connect(self.set_zero)
        self.live_bar.record.clicked.connect(self._toggle_recording)
        self.live_bar.follow.clicked.connect(self.set_following)
        self.live_bar.stop.clicked.connect(self.stop_watching)
        self._window.timeline.frame_chosen.connect(self._stop_following)
        controller.closing.connect(self._close)

    @property
    def is_on_screen(self) -> bool:
        """Whether the live source is the open recording."""
        return self.reader is not None and self._controller.session.recording == self._path

    def show_dialog(self) -> None:
        """Ask for the source."""
        self._list_cameras()
        self.dialog.show()
        self.dialog.raise_()

    def watch_source(self, source: LiveSource, partner: LiveSource | None = None) -> None:
        """Start reading a source and the partner beside it; they open once they have references."""
        self.stop_watching()
        self._n_watched += 1
        self._path = Path(f"live:/{self._n_watched}")
        self.reader = make_reader(source, partner)
        self.reader.start()
        self.is_following = True
        self._shown_partner = -1
        self.live_bar.show_source(self.reader.title)
        self.live_bar.show_state(following=True, recording=False)
        self._timer.start()

    def stop_watching(self) -> None:
        """Stop reading; the frames in memory stay open."""
        self.stop_recording()
        if self.reader is not None:
            self.reader.stop()
            self.is_following = False
        self._timer.stop()
        self.live_bar.hide()

    def set_following(self, on: bool) -> None:
        """Follow the newest frame, or stay on the current one."""
        self.is_following = on
        if on and not self.is_on_screen and self.reader is not None and self.reader.has_reference:
            self._open(self.reader)
        self.live_bar.show_state(following=on, recording=self.recorder is not None)

    def set_zero(self) -> None:
        """Capture the reference from the last frames."""
        if self.reader is not None:
            self.reader.capture_reference()

    def start_recording(self, path: Path) -> None:
        """Record every frame from now on."""
        if self.reader is None:
            return
        try:
            self.recorder = LiveRecorder(path, self.reader)
        except TouchError as error:
            self._controller.show_problem(error)
        self.live_bar.show_state(following=self.is_following, recording=self.recorder is not None)

    def stop_recording(self) -> None:
        """End the recording; its last frames are written in the background."""
        recorder = self.recorder
        self.recorder = None
        if recorder is None:
            return
        recorder.close(0.0)
        self._autosave.preferences.add_recent(recorder.path)
        self.live_bar.show_state(following=self.is_following, recording=False)

    def _watch_described(
        self, words: list[str], sensor: str, partner: str, beside: str, tool: str, rate_hz: float
    ) -> None:
        try:
            sources = parse_sources(
                words,
                [partner],
                sensor=sensor,
                partner_sensor=beside or self._controller.session.target,
                tool=tool,
                rate_hz=rate_hz,
            )
            self.watch_source(*sources)
        except TouchError as error:
            self._controller.show_problem(error)

    def _list_cameras(self) -> None:
        cameras = [
            (c.name, f"{c.name} ({c.profile.sensor})" if c.profile.sensor else c.name)
            for c in list_usb_cameras()
        ]
        self.dialog.show_cameras(cameras)

    def _ask_folder(self) -> None:
        chosen = QFileDialog.getExistingDirectory(
            self.dialog, "Folder that grows", self._autosave.dialog_folder
        )
        if chosen:
            self.dialog.show_folder(chosen)

    def _toggle_recording(self, on: bool) -> None:
        path = (
            dialogs.ask_export_path(self._window, "Record", ".h5", self._autosave.dialog_folder)
            if on
            else None
        )
        if path is not None:
            self._autosave.preferences.last_folder = path.parent
            self.start_recording(path)
        elif not on:
            self.stop_recording()
        self.live_bar.show_state(following=self.is_following, recording=self.recorder is not None)

    def _update(self) -> None:
        """Show the status, and the newest frame if the stages are idle."""
        reader = self.reader
        if reader is None:
            return
        self._show_status(reader.status())
        if self.is_on_screen:
            self._show_new_frames(reader.n_frames)
            if isinstance(reader, PairedReader):
                self._show_partner(reader)
        elif self.is_following and reader.has_reference and self._opened != self._path:
            self._open(reader)
        elif self.is_following and self._opened == self._path:  # another recording was opened
            self.set_following(on=False)

    def _open(self, reader: LiveReader) -> None:
        mount(self._path, lambda path=self._path: reader.make_recording(path))
        self._opened = self._path
        self._controller.change(
            "open live source",
            recording=self._path,
            frame=reader.n_frames - 1,
            source="",
            stream="",
            reference=None,
            reference_frames="",
            calibration=None,
            mesh=None,
            mesh_unit="auto",
            depth_unit="auto",
        )

    def _show_new_frames(self, n_frames: int) -> None:
        controller = self._controller
        opened = self._controller.views.translation
        if opened is None or opened.request.recording != self._path or not controller.is_idle:
            return
        if not self._window.timeline.slider.isSliderDown():
            self._window.timeline.show_frames(n_frames)
            self._window.frames.model.grow_to(n_frames)
        if self.is_following and controller.session.frame != n_frames - 1:
            controller.choose_frame(n_frames - 1)

    def _show_partner(self, reader: PairedReader) -> None:
        """Show what the partner took of the frame on screen."""
        shown = self._controller.latest_frame
        if shown is None or shown.index == self._shown_partner:
            return
        self._shown_partner = shown.index
        frame = reader.find_partner(shown.index)
        display = self._controller.session.display
        self.live_bar.show_partner(
            None
            if frame is None
            else make_recorded_preview(frame, load_sensor(frame.sensor), display)[0].pixels
        )

    def _show_status(self, status: ReaderStatus) -> None:
        rates = status.describe()
        recorder = self.recorder
        if recorder is not None:
            rates += f"; {recorder.n_written} recorded"
            rates += f", {recorder.n_dropped} dropped" if recorder.n_dropped else ""
        problem = status.message or (recorder.problem if recorder is not None else "")
        if (rates + problem) != self._shown_text:
            self._shown_text = rates + problem
            self.live_bar.show_rates(rates, problem)

    def _stop_following(self, frame: int) -> None:
        """Stop following when the user moves the timeline."""
        if self.is_on_screen and self.reader is not None and frame != self.reader.n_frames - 1:
            self.set_following(on=False)

    def _close(self) -> None:
        if self.reader is not None:
            self.reader.stop(_STOP_TIMEOUT_S)
        if self.recorder is not None:
            self.recorder.close(_RECORDER_TIMEOUT_S)
        for number in range(1, self._n_watched + 1):
            unmount(Path(f"live:/{number}"))
