"""A sensor on screen: read by a thread of its own, the newest frame shown when the stages are free, recorded beside."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtCore import QObject, QTimer
from PyQt6.QtWidgets import QFileDialog

from app.window import dialogs
from app.window.autosave import AutosaveController
from app.window.session_controller import SessionController
from pipeline.base.errors import TouchError
from pipeline.live.reader import LiveReader, ReaderStatus
from pipeline.live.recorder import LiveRecorder
from pipeline.live.source import LiveSource
from pipeline.live.source_parsing import parse_source
from pipeline.live.usb_camera import list_usb_cameras
from pipeline.recordings.mounts import mount, unmount
from pipeline.sensors.spec import list_sensor_names
from pipeline.simulation import shapes
from widgets.live_bar import LiveBar
from widgets.live_dialog import LiveDialog

_LOOK_EVERY_MS = 33
_PATIENCE_S = 1.0  # for the reader's thread, when the window goes; a camera that hangs is left to itself
_CLOSE_S = 5.0  # for a recording's last frames to be written when the window goes


class LiveController(QObject):
    """Between a reader and the controller; nothing here waits for a sensor or a disk."""

    def __init__(self, controller: SessionController, keeping: AutosaveController) -> None:
        super().__init__(controller)
        self._controller, self._keeping, self._window = controller, keeping, controller.window
        self.live_bar, self.dialog = LiveBar(), LiveDialog(self._window)
        self._window.add_strip(self.live_bar)
        self.dialog.show_choices(list_sensor_names(), shapes.list_shapes())
        self.reader: LiveReader | None = None
        self.recorder: LiveRecorder | None = None
        self.is_following, self._n_watched, self._said = False, 0, ""
        self._path = self._opened = Path()  # the name of what is watched, and of what was opened of it last
        self._clock = QTimer(self)
        self._clock.setInterval(_LOOK_EVERY_MS)
        self._clock.timeout.connect(self._look)
        self._window.connect_command("live", self.show_dialog)
        self.dialog.watch_requested.connect(self._watch_words)
        self.dialog.cameras_requested.connect(self._list_cameras)
        self.dialog.folder_requested.connect(self._ask_folder)
        self.live_bar.zero_requested.connect(self.set_zero)
        self.live_bar.record_toggled.connect(self._toggle_recording)
        self.live_bar.follow_toggled.connect(self.set_following)
        self.live_bar.stop_requested.connect(self.stop_watching)
        self._window.timeline.frame_chosen.connect(self._looked_back)
        controller.closing.connect(self._close)

    @property
    def is_on_screen(self) -> bool:
        """Whether what is watched is what is open."""
        return self.reader is not None and self._controller.session.recording == self._path

    def show_dialog(self) -> None:
        """Ask which sensor."""
        self._list_cameras()
        self.dialog.show()
        self.dialog.raise_()

    def watch_source(self, source: LiveSource) -> None:
        """Begin with a sensor; it is opened once its first zero is set."""
        self.stop_watching()
        self._n_watched += 1
        self._path = Path(f"live:/{self._n_watched}")
        self.reader = LiveReader(source)
        self.reader.start()
        self.is_following = True
        self.live_bar.show_source(source.title)
        self.live_bar.show_state(following=True, recording=False)
        self._clock.start()

    def stop_watching(self) -> None:
        """Let go of the sensor; what is held of it can still be looked at."""
        self.stop_recording()
        if self.reader is not None:
            self.reader.stop()
            self.is_following = False
        self._clock.stop()
        self.live_bar.hide()

    def set_following(self, on: bool) -> None:
        """Show the newest frame from now on, or stay on the one on screen."""
        self.is_following = on
        if on and not self.is_on_screen and self.reader is not None and self.reader.has_reference:
            self._open(self.reader)
        self.live_bar.show_state(following=on, recording=self.recorder is not None)

    def set_zero(self) -> None:
        """The last readings are the untouched sensor."""
        if self.reader is not None:
            self.reader.capture_reference()

    def start_recording(self, path: Path) -> None:
        """Write every frame from now on."""
        if self.reader is None:
            return
        try:
            self.recorder = LiveRecorder(path, self.reader.source.title)
        except TouchError as error:
            self._controller.show_problem(error)
        else:
            self.reader.set_listener(self.recorder.offer)
        self.live_bar.show_state(following=self.is_following, recording=self.recorder is not None)

    def stop_recording(self) -> None:
        """End the file; its last frames are written beside."""
        recorder, self.recorder = self.recorder, None
        if recorder is None:
            return
        if self.reader is not None:
            self.reader.set_listener(None)
        recorder.close(0.0)
        self._keeping.preferences.add_recent(recorder.path)
        self.live_bar.show_state(following=self.is_following, recording=False)

    def _watch_words(self, words: list[str], sensor: str, tool: str, rate_hz: float) -> None:
        try:
            self.watch_source(parse_source(words, sensor=sensor, tool=tool, rate_hz=rate_hz))
        except TouchError as error:
            self._controller.show_problem(error)

    def _list_cameras(self) -> None:
        cameras = [
            (c.name, f"{c.name} ({c.profile.sensor})" if c.profile.sensor else c.name) for c in list_usb_cameras()
        ]
        self.dialog.show_cameras(cameras)

    def _ask_folder(self) -> None:
        chosen = QFileDialog.getExistingDirectory(self.dialog, "Folder that grows", self._keeping.dialog_folder)
        if chosen:
            self.dialog.show_folder(chosen)

    def _toggle_recording(self, on: bool) -> None:
        path = dialogs.ask_export_path(self._window, "Record", ".h5", self._keeping.dialog_folder) if on else None
        if path is not None:
            self._keeping.preferences.last_folder = path.parent
            self.start_recording(path)
        elif not on:
            self.stop_recording()
        self.live_bar.show_state(following=self.is_following, recording=self.recorder is not None)

    def _look(self) -> None:
        """What there is to say, and the newest frame where the stages are free for it."""
        reader = self.reader
        if reader is None:
            return
        self._say(reader.status())
        if self.is_on_screen:
            self._grow(reader.n_frames)
        elif self.is_following and reader.has_reference and self._opened != self._path:
            self._open(reader)
        elif self.is_following and self._opened == self._path:  # another recording was opened meanwhile
            self.set_following(on=False)

    def _open(self, reader: LiveReader) -> None:
        mount(self._path, lambda path=self._path: reader.make_recording(path))
        self._opened = self._path
        self._controller.change(
            "watch a sensor", recording=self._path, frame=reader.n_frames - 1, source="", stream="", reference=None,
            calibration=None, mesh=None, mesh_unit="auto", depth_unit="auto",
        )  # fmt: skip

    def _grow(self, n_frames: int) -> None:
        controller, opened = self._controller, self._controller.views.translation
        if opened is None or opened.request.recording != self._path or not controller.is_idle:
            return
        if not self._window.timeline.slider.isSliderDown():
            self._window.timeline.show_frames(n_frames)
            self._window.frames.model.grow_to(n_frames)
        if self.is_following and controller.session.frame != n_frames - 1:
            controller.choose_frame(n_frames - 1)

    def _say(self, status: ReaderStatus) -> None:
        rates = f"{status.state} · {status.rate_hz:.1f} Hz · {status.n_frames} frames · {status.n_lost} lost"
        recorder = self.recorder
        if recorder is not None:
            rates += f" · {recorder.n_written} recorded"
            rates += f", {recorder.n_dropped} left out" if recorder.n_dropped else ""
        wrong = status.message or (recorder.problem if recorder is not None else "")
        if (rates + wrong) != self._said:
            self._said = rates + wrong
            self.live_bar.show_rates(rates, wrong)

    def _looked_back(self, frame: int) -> None:
        """The timeline was moved by hand: stay there while it goes on."""
        if self.is_on_screen and self.reader is not None and frame != self.reader.n_frames - 1:
            self.set_following(on=False)

    def _close(self) -> None:
        self._clock.stop()
        if self.reader is not None:
            self.reader.set_listener(None)
            self.reader.stop(_PATIENCE_S)
        if self.recorder is not None:
            self.recorder.close(_CLOSE_S)
        for number in range(1, self._n_watched + 1):
            unmount(Path(f"live:/{number}"))
