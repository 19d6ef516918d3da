"""The thread that reads a live sensor and buffers its last frames."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from pipeline.core.arrays import Floats, Image, freeze
from pipeline.core.errors import FileProblem, TouchError
from pipeline.core.values.frames import Recording, Stream, TactileFrame, Truth
from pipeline.io.live import reference_capture
from pipeline.io.live.source import LiveFrame, LiveSource
from pipeline.sensors.spec import load_sensor

MAX_BYTES = 192 << 20  # of the buffered images
RETRY_S = 0.3  # before a lost sensor is opened again
_RATE_WINDOW_S = 2.0  # over which the frame rate is measured
_CLOCK_JUMP_S = 2.0  # by which stamps and arrivals may differ from one frame to the next
_DRIFT_CHECK_S = 1.0  # between two checks of the reference

ReaderState = Literal["looking", "running", "lost", "stopped"]
Listener = Callable[[TactileFrame, Truth | None], object]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReaderStatus:
    """State of a live sensor."""

    state: ReaderState
    n_frames: int
    rate_hz: float  # of arriving frames, over the last two seconds
    n_lost: int  # frames that the sensor counted but that did not arrive
    n_doubled: int = 0  # frames with the stamp of the one before
    n_clock_jumps: int = 0  # steps of the sensor's clock that its rate does not explain
    message: str = ""  # what is wrong: sensor lost, or reference does not fit


class LiveReader:
    """Reads `source` until stopped, through any number of losses.

    All methods may be called by any thread.
    """

    def __init__(self, source: LiveSource, *, max_bytes: int = MAX_BYTES) -> None:
        self.source = source
        self._max_bytes = max_bytes
        self._lock = threading.Lock()
        self._buffer: deque[tuple[TactileFrame, Truth | None]] = deque()
        self._first_index = self._n_bytes = self._n_lost = self._n_doubled = self._n_jumps = 0
        self._arrivals_s: deque[float] = deque()
        self._reference: Image | Floats | None = None
        self._first_reference: Image | Floats | None = None
        self._checked_reference: Image | Floats | None = None  # the last one without a warning
        self._start_s = time.monotonic()
        self._state: ReaderState = "looking"
        self._problem = self._drift = ""
        self._number = -1
        self._began_s = 0.0
        self._checked_s = 0.0
        self._last: LiveFrame | None = None
        self._listeners: tuple[Listener, ...] = ()
        self._stop_event = threading.Event()
        self._thread = threading.Thread(target=self._read_frames, name="live", daemon=True)

    def start(self) -> None:
        """Start live_frame."""
        self._thread.start()

    def stop(self, timeout_s: float = 0.0) -> bool:
        """Ask the thread to end; whether it has ended within the timeout. A camera may hang."""
        self._stop_event.set()
        if self._thread.is_alive() and timeout_s > 0:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def set_listener(self, listener: Listener | None) -> None:
        """Call `listener` with every frame on the reader's thread; None removes it."""
        self._listeners = () if listener is None else (listener,)

    @property
    def n_frames(self) -> int:
        """Number of frames so far."""
        with self._lock:
            return self._first_index + len(self._buffer)

    @property
    def has_reference(self) -> bool:
        """Whether a reference has been captured."""
        return self._reference is not None

    def frame(self, index: int) -> TactileFrame:
        """A buffered frame; frames before the first reference get that one. Raises FileProblem
        for one that is gone.
        """
        frame = self._get_buffered(index)[0]
        first = self._first_reference
        fits = first is not None and frame.reference is None and first.shape == frame.image.shape
        return replace(frame, reference=first) if fits else frame

    def measure_age_s(self, frame: TactileFrame) -> float:
        """How long ago one of its frames was taken."""
        return time.monotonic() - self._start_s - frame.time_s

    def truth(self, index: int) -> Truth | None:
        """The ground truth of a simulated frame, else None."""
        return self._get_buffered(index)[1]

    def capture_reference(self) -> str:
        """Set the reference to the median of the last frames, from the next frame on.

        Returns a warning or "".
        """
        images = self._get_last_images()
        if len(images) < reference_capture.MIN_FRAMES:
            return (
                f"a reference needs {reference_capture.MIN_FRAMES} frames, there are {len(images)}"
            )
        self._reference = reference_capture.compute_median_image(images)
        if self._first_reference is None or self._first_reference.shape != self._reference.shape:
            self._first_reference = self._reference
        spec = load_sensor(self.source.sensor)
        before = self._checked_reference
        new_contact = (
            ""
            if before is None
            else reference_capture.check_new_contact(self._reference, before, spec)
        )
        self._problem = reference_capture.check_motion(images, spec) or new_contact
        if not self._problem:
            self._checked_reference = self._reference
        self._drift = ""
        return self._problem

    def _get_last_images(self) -> list[Image | Floats]:
        with self._lock:
            images = [
                frame.image for frame, _ in list(self._buffer)[-reference_capture.MAX_FRAMES :]
            ]
        other = next(
            (k for k, image in enumerate(reversed(images)) if image.shape != images[-1].shape),
            len(images),
        )
        return images[len(images) - other :]

    def status(self) -> ReaderStatus:
        """State, frame rate and problems now."""
        now_s = time.monotonic()
        with self._lock:
            arrived = [at_s for at_s in self._arrivals_s if now_s - at_s <= _RATE_WINDOW_S]
            n = self._first_index + len(self._buffer)
            n_lost = self._n_lost
        window_s = min(_RATE_WINDOW_S, now_s - self._began_s)
        rate = len(arrived) / window_s if window_s > 0 and self._state == "running" else 0.0
        return ReaderStatus(
            state=self._state,
            n_frames=n,
            rate_hz=rate,
            n_lost=n_lost,
            n_doubled=self._n_doubled,
            n_clock_jumps=self._n_jumps,
            message=self._problem or self._drift,
        )

    def make_recording(self, path: Path) -> Recording:
        """The frames so far as a recording that grows, named `path`."""
        sensor = self.source.sensor
        stream = Stream(
            name=sensor,
            sensor=sensor,
            n_frames=self.n_frames,
            frame=self.frame,
            truth=self.truth,
            has_truth=True,
        )
        mesh, symmetry = self.source.touching_object or (None, None)
        return Recording(
            path=path,
            format="live sensor",
            streams=(stream,),
            notes=(f"live: {self.source.title}",),
            object_mesh=mesh,
            symmetry=symmetry,
            refresh=lambda: self.make_recording(path),
        )

    def _get_buffered(self, index: int) -> tuple[TactileFrame, Truth | None]:
        with self._lock:
            place = index - self._first_index
            if 0 <= place < len(self._buffer):
                return self._buffer[place]
            first = self._first_index
            n = self._first_index + len(self._buffer)
        raise FileProblem(
            f"frame {index} is no longer buffered, only {first} to {n - 1} are; record to keep all",
            self.source.title,
        )

    def _read_frames(self) -> None:
        opened = False
        while not self._stop_event.is_set():
            try:
                if not opened:
                    self.source.open()
                    opened = True
                    self._number = -1
                    self._began_s = time.monotonic()
                    self._last = None
                live_frame = self.source.read()
                if live_frame is not None:
                    self._add_frame(live_frame)
            except Exception as error:  # noqa: BLE001 - a border: errors of a driver count as a lost sensor
                failure = f"the sensor's driver failed ({type(error).__name__}: {error})"
                self._problem = str(error) if isinstance(error, TouchError) else failure
                self._state = "lost" if self._buffer else "looking"
                self.source.close()
                opened = False
                self._stop_event.wait(RETRY_S)
        if opened:
            self.source.close()
        self._state = "stopped"

    def _add_frame(self, live_frame: LiveFrame) -> None:
        image = freeze(live_frame.image)
        self._check_clock(live_frame)
        if self._state != "running":
            self._state = "running"
            self._problem = ""
        if self._reference is not None and image.shape != self._reference.shape:
            (rows, cols), (r, c) = image.shape[:2], self._reference.shape[:2]
            self._problem = (
                f"images are now {cols} x {rows} px, {c} x {r} before; a new reference is taken"
            )
            self._reference = None
        with self._lock:
            index = self._first_index + len(self._buffer)
            frame = TactileFrame(
                sensor=self.source.sensor,
                image=image,
                reference=self._reference,
                index=index,
                time_s=live_frame.time_s - self._start_s,
                origin=f"{self.source.title} [frame {index}]",
                camera=live_frame.camera,
            )
            self._buffer.append((frame, live_frame.truth))
            self._n_bytes += image.nbytes
            while (
                self._n_bytes > self._max_bytes and len(self._buffer) > reference_capture.MAX_FRAMES
            ):
                self._n_bytes -= self._buffer.popleft()[0].image.nbytes
                self._first_index += 1
            self._arrivals_s.append(live_frame.time_s)
            while live_frame.time_s - self._arrivals_s[0] > _RATE_WINDOW_S:
                self._arrivals_s.popleft()
            if 0 <= self._number < live_frame.sequence_number - 1:
                self._n_lost += live_frame.sequence_number - 1 - self._number
        self._number = live_frame.sequence_number
        self._check_reference(frame)
        for listener in self._listeners:
            listener(frame, live_frame.truth)

    def _check_clock(self, frame: LiveFrame) -> None:
        """Count frames that came twice and jumps of the sensor's clock.

        Frames are timed by their arrival.
        """
        if self._last is not None and math.isfinite(frame.stamp_s - self._last.stamp_s):
            step_s = frame.stamp_s - self._last.stamp_s
            self._n_doubled += step_s == 0
            self._n_jumps += abs(step_s - (frame.time_s - self._last.time_s)) > _CLOCK_JUMP_S
        self._last = frame

    def _check_reference(self, frame: TactileFrame) -> None:
        """Capture the first reference automatically; check it for drift every `_DRIFT_CHECK_S`."""
        if self._reference is None:
            if len(self._get_last_images()) >= reference_capture.AUTO_CAPTURE_FRAMES:
                self.capture_reference()
        elif frame.time_s - self._checked_s > _DRIFT_CHECK_S:
            self._checked_s = frame.time_s
            self._drift = reference_capture.check_drift(
                frame.image, self._reference, load_sensor(frame.sensor)
            )
