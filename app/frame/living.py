"""A sensor on screen: read by a thread of its own, the newest frame shown when the stages are free, recorded beside."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtCore import QObject, QTimer
from PyQt6.QtWidgets import QFileDialog

from app.frame import dialogs
from app.frame.instrument import Instrument
from app.frame.keeping import Keeping
from pipeline.base.errors import TouchError
from pipeline.live.device import found
from pipeline.live.reader import Reader, Status
from pipeline.live.recorder import Recorder
from pipeline.live.source import Source
from pipeline.live.sources import source_of
from pipeline.recordings.mounted import mount, unmount
from pipeline.sensors.spec import names
from pipeline.simulation import shapes
from widgets.live_bar import LiveBar
from widgets.live_dialog import LiveDialog

_LOOK_EVERY_MS = 33
_PATIENCE_S = 1.0  # for the reader's thread, when the window goes; a camera that hangs is left to itself
_CLOSE_S = 5.0  # for a recording's last frames to be written when the window goes


class Living(QObject):
    """Between a reader and the instrument; nothing here waits for a sensor or a disk."""

    def __init__(self, instrument: Instrument, keeping: Keeping) -> None:
        super().__init__(instrument)
        self._instrument, self._keeping, self._window = instrument, keeping, instrument.window
        self.bar, self.dialog = LiveBar(), LiveDialog(self._window)
        self._window.add_strip(self.bar)
        self.dialog.show_choices(names(), shapes.names())
        self.reader: Reader | None = None
        self.recorder: Recorder | None = None
        self.following, self._n_watched, self._said = False, 0, ""
        self._path = self._opened = Path()  # the name of what is watched, and of what was opened of it last
        self._clock = QTimer(self)
        self._clock.setInterval(_LOOK_EVERY_MS)
        self._clock.timeout.connect(self._look)
        self._window.on("live", self.ask)
        self.dialog.watch_wanted.connect(self._watch_words)
        self.dialog.cameras_wanted.connect(self._list_cameras)
        self.dialog.folder_wanted.connect(self._ask_folder)
        self.bar.zero_wanted.connect(self.set_zero)
        self.bar.record_toggled.connect(self._toggle_recording)
        self.bar.follow_toggled.connect(self.follow)
        self.bar.stop_wanted.connect(self.stop)
        self._window.timeline.frame_chosen.connect(self._looked_back)
        instrument.closing.connect(self._close)

    @property
    def on_screen(self) -> bool:
        """Whether what is watched is what is open."""
        return self.reader is not None and self._instrument.session.recording == self._path

    def ask(self) -> None:
        """Ask which sensor."""
        self._list_cameras()
        self.dialog.show()
        self.dialog.raise_()

    def watch(self, source: Source) -> None:
        """Begin with a sensor; it is opened once its first zero is set."""
        self.stop()
        self._n_watched += 1
        self._path = Path(f"live:/{self._n_watched}")
        self.reader = Reader(source)
        self.reader.start()
        self.following = True
        self.bar.show_source(source.title)
        self.bar.show_state(following=True, recording=False)
        self._clock.start()

    def stop(self) -> None:
        """Let go of the sensor; what is held of it can still be looked at."""
        self.stop_recording()
        if self.reader is not None:
            self.reader.stop()
            self.following = False
        self._clock.stop()
        self.bar.hide()

    def follow(self, on: bool) -> None:
        """Show the newest frame from now on, or stay on the one on screen."""
        self.following = on
        if on and not self.on_screen and self.reader is not None and self.reader.has_zero:
            self._open(self.reader)
        self.bar.show_state(following=on, recording=self.recorder is not None)

    def set_zero(self) -> None:
        """The last readings are the untouched sensor."""
        if self.reader is not None:
            self.reader.set_zero()

    def record(self, path: Path) -> None:
        """Write every frame from now on."""
        if self.reader is None:
            return
        try:
            self.recorder = Recorder(path, self.reader.source.title)
        except TouchError as error:
            self._instrument.show_problem(error)
        else:
            self.reader.listen(self.recorder.offer)
        self.bar.show_state(following=self.following, recording=self.recorder is not None)

    def stop_recording(self) -> None:
        """End the file; its last frames are written beside."""
        recorder, self.recorder = self.recorder, None
        if recorder is None:
            return
        if self.reader is not None:
            self.reader.listen(None)
        recorder.close(0.0)
        self._keeping.remembered.add_recent(recorder.path)
        self.bar.show_state(following=self.following, recording=False)

    def _watch_words(self, words: list[str], sensor: str, tool: str, rate_hz: float) -> None:
        try:
            self.watch(source_of(words, sensor=sensor, tool=tool, rate_hz=rate_hz))
        except TouchError as error:
            self._instrument.show_problem(error)

    def _list_cameras(self) -> None:
        cameras = [(c.name, f"{c.name} ({c.kind.sensor})" if c.kind.sensor else c.name) for c in found()]
        self.dialog.show_cameras(cameras)

    def _ask_folder(self) -> None:
        chosen = QFileDialog.getExistingDirectory(self.dialog, "Folder that grows", self._keeping.folder)
        if chosen:
            self.dialog.show_folder(chosen)

    def _toggle_recording(self, on: bool) -> None:
        path = dialogs.to_save_as(self._window, "Record", ".h5", self._keeping.folder) if on else None
        if path is not None:
            self._keeping.remembered.folder = path.parent
            self.record(path)
        elif not on:
            self.stop_recording()
        self.bar.show_state(following=self.following, recording=self.recorder is not None)

    def _look(self) -> None:
        """What there is to say, and the newest frame where the stages are free for it."""
        reader = self.reader
        if reader is None:
            return
        self._say(reader.status())
        if self.on_screen:
            self._grow(reader.n_frames)
        elif self.following and reader.has_zero and self._opened != self._path:
            self._open(reader)
        elif self.following and self._opened == self._path:  # another recording was opened meanwhile
            self.follow(on=False)

    def _open(self, reader: Reader) -> None:
        mount(self._path, lambda path=self._path: reader.recording(path))
        self._opened = self._path
        self._instrument.change(
            "watch a sensor", recording=self._path, frame=reader.n_frames - 1, source="", stream="", reference=None,
            calibration=None, mesh=None, mesh_unit="auto", depth_unit="auto",
        )  # fmt: skip

    def _grow(self, n_frames: int) -> None:
        instrument, opened = self._instrument, self._instrument.screen.opened
        if opened is None or opened.request.recording != self._path or not instrument.idle:
            return
        if not self._window.timeline.slider.isSliderDown():
            self._window.timeline.show_frames(n_frames)
            self._window.frames.known.grow(n_frames)
        if self.following and instrument.session.frame != n_frames - 1:
            instrument.choose_frame(n_frames - 1)

    def _say(self, status: Status) -> None:
        rates = f"{status.state} · {status.rate_hz:.1f} Hz · {status.n_frames} frames · {status.n_lost} lost"
        recorder = self.recorder
        if recorder is not None:
            rates += f" · {recorder.n_written} recorded"
            rates += f", {recorder.n_left_out} left out" if recorder.n_left_out else ""
        wrong = status.sentence or (recorder.problem if recorder is not None else "")
        if (rates + wrong) != self._said:
            self._said = rates + wrong
            self.bar.show_rates(rates, wrong)

    def _looked_back(self, frame: int) -> None:
        """The timeline was moved by hand: stay there while it goes on."""
        if self.on_screen and self.reader is not None and frame != self.reader.n_frames - 1:
            self.follow(on=False)

    def _close(self) -> None:
        self._clock.stop()
        if self.reader is not None:
            self.reader.listen(None)
            self.reader.stop(_PATIENCE_S)
        if self.recorder is not None:
            self.recorder.close(_CLOSE_S)
        for number in range(1, self._n_watched + 1):
            unmount(Path(f"live:/{number}"))
