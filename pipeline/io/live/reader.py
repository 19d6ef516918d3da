"""The thread that reads a live sensor and buffers its last frames."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from pipeline.core.arrays import Floats, Image, freeze
from pipeline.core.errors import FileProblem, TouchError
from pipeline.core.frozen import frozen
from pipeline.core.values.frames import Recording, Stream, TactileFrame, Truth
from pipeline.io.live import reference_capture
from pipeline.io.live.sensor_clock import SensorClock
from pipeline.io.live.source import LiveFrame, LiveSource
from pipeline.sensors.spec import load_sensor

MAX_BYTES = 192 << 20  # of the buffered images
RETRY_S = 0.3  # before a lost sensor is opened again
_RATE_WINDOW_S = 2.0  # over which the frame rate is measured
_DRIFT_CHECK_S = 1.0  # between two checks of the reference

ReaderState = Literal["looking", "running", "lost", "stopped"]
Listener = Callable[[str, TactileFrame, Truth | None], object]  # the first is the stream's name


@frozen
class ReaderStatus:
    """State of a live sensor."""

    state: ReaderState
    n_frames: int
    rate_hz: float  # of arriving frames, over the last two seconds
    n_lost: int  # frames that did not arrive, as far as the sensor tells
    n_doubled: int = 0  # frames with the stamp of the one before
    n_clock_jumps: int = 0  # steps of the sensor's clock that its rate does not explain
    message: str = ""  # what is wrong: sensor lost, or reference does not fit
    n_unpaired: int = 0  # frames at whose time a sensor beside it took none
    partner: "ReaderStatus | None" = None  # of that sensor

    def describe(self) -> str:
        """State, rate and counts in one line."""
        counts = (
            (self.n_doubled, "doubled"),
            (self.n_clock_jumps, "jumps of its clock"),
            (self.n_unpaired, "without a partner"),
        )
        parts = (
            f"{self.state}: {self.rate_hz:.1f} Hz, {self.n_frames} frames, {self.n_lost} lost",
            *(f"{n} {what}" for n, what in counts if n),
        )
        beside = "" if self.partner is None else f"; partner {self.partner.describe()}"
        return ", ".join(parts) + beside


class LiveReader:
    """Reads `source` until stopped, through any number of losses; times are those of the reader
    `beside` it, if any.

    All methods may be called by any thread.
    """

    def __init__(
        self,
        source: LiveSource,
        *,
        max_bytes: int = MAX_BYTES,
        beside: "LiveReader | None" = None,
    ) -> None:
        self.source = source
        self._beside = beside
        self._max_bytes = max_bytes
        self._lock = threading.Lock()
        self._buffer: deque[tuple[TactileFrame, Truth | None]] = deque()
        self._first_index = self._n_bytes = 0
        self._clock = SensorClock()
        self._arrivals_s: deque[float] = deque()
        self._reference: Image | Floats | None = None
        self._first_reference: Image | Floats | None = None
        self._checked_reference: Image | Floats | None = None  # the last one without a warning
        self._start_s = time.monotonic() if beside is None else beside._start_s
        self._state: ReaderState = "looking"
        self._problem = self._drift = ""
        self._began_s = 0.0
        self._checked_s = 0.0
        self._listeners: tuple[Listener, ...] = ()
        self._stop_event = threading.Event()
        self._thread = threading.Thread(target=self._read_frames, name="live", daemon=True)

    def start(self) -> None:
        """Begin to read."""
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
    def title(self) -> str:
        """Name for people."""
        return self.source.title

    @property
    def stream_name(self) -> str:
        """Name of its stream: that of the sensor."""
        name = self.source.sensor
        is_taken = self._beside is not None and self._beside.source.sensor == name
        return f"{name}_2" if is_taken else name

    @property
    def n_frames(self) -> int:
        """Number of frames so far."""
        with self._lock:
            return self._first_index + len(self._buffer)

    @property
    def newest_s(self) -> float:
        """Time of the newest frame; minus infinity without one."""
        with self._lock:
            return self._buffer[-1][0].time_s if self._buffer else -math.inf

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
        window_s = min(_RATE_WINDOW_S, now_s - self._began_s)
        rate = len(arrived) / window_s if window_s > 0 and self._state == "running" else 0.0
        return ReaderStatus(
            state=self._state,
            n_frames=n,
            rate_hz=rate,
            n_lost=self._clock.n_lost,
            n_doubled=self._clock.n_doubled,
            n_clock_jumps=self._clock.n_jumps,
            message=self._problem or self._drift,
        )

    def make_recording(self, path: Path) -> Recording:
        """The frames so far as a recording that grows, named `path`."""
        mesh, symmetry = self.source.touching_object or (None, None)
        return Recording(
            path=path,
            format="live sensor",
            streams=self.make_streams(),
            notes=(f"live: {self.title}",),
            object_mesh=mesh,
            symmetry=symmetry,
            refresh=lambda: self.make_recording(path),
        )

    def make_streams(self) -> tuple[Stream, ...]:
        """The frames so far with their times, which are NaN for those that are gone."""
        n = self.n_frames
        times_s = np.full(n, np.nan)
        with self._lock:
            for frame, _ in self._buffer:
                if frame.index < n:
                    times_s[frame.index] = frame.time_s
        stream = Stream(
            name=self.stream_name,
            sensor=self.source.sensor,
            n_frames=n,
            frame=self.frame,
            truth=self.truth,
            has_truth=True,
            times_s=freeze(times_s),
        )
        return (stream,)

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
                    self._clock.restart()
                    self._began_s = time.monotonic()
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
        taken_s = self._clock.add(live_frame)
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
                time_s=taken_s - self._start_s,
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
        self._check_reference(frame)
        for listener in self._listeners:
            listener(self.stream_name, frame, live_frame.truth)

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
