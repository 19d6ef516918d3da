"""The thread that reads a sensor, and what it holds of it: the newest reading at once, some back to scrub through."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from pipeline.base.arrays import Floats, Image, freeze
from pipeline.base.errors import FileProblem, TouchError
from pipeline.live import reference_capture
from pipeline.live.source import LiveFrame, LiveSource, LiveSourceLost
from pipeline.sensors.spec import SensorSpec
from pipeline.sensors.spec import load_sensor as sensor_named
from pipeline.values.frames import Recording, Stream, TactileFrame, Truth

MAX_BYTES = 192 << 20  # held to scrub back through
RETRY_S = 0.3  # before a lost sensor is looked for again
_RATE_OVER_S = 2.0
_CHECK_EVERY_S = 1.0  # whether the reference still fits

ReaderState = Literal["looking", "running", "lost", "stopped"]
Listener = Callable[[TactileFrame, Truth | None], object]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReaderStatus:
    """What is to be said of a sensor now."""

    state: ReaderState
    n_frames: int
    rate_hz: float  # that really arrives, over the last two seconds
    n_lost: int  # that the sensor counted and nobody got
    message: str = ""  # what is wrong: lost, or zero does not fit


@dataclass(frozen=True, slots=True, kw_only=True)
class _Held:
    frame: TactileFrame
    truth: Truth | None


class LiveReader:
    """Reads `source` until it is stopped, through any number of losses; every other method may be called by anybody."""

    def __init__(self, source: LiveSource, *, most_bytes: int = MAX_BYTES) -> None:
        self.source, self._most_bytes = source, most_bytes
        self._lock = threading.Lock()
        self._held: deque[_Held] = deque()
        self._first = self._n_bytes = self._lost = 0
        self._arrived: deque[float] = deque()
        self._reference: Image | Floats | None = None
        self._first_zero: Image | Floats | None = None
        self._sure_zero: Image | Floats | None = None  # the last one that nothing spoke against
        self._start_s = time.monotonic()
        self._state: ReaderState = "looking"
        self._problem = self._drift = ""
        self._number, self._began_s, self._checked_s = -1, 0.0, 0.0
        self._listeners: tuple[Listener, ...] = ()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="live", daemon=True)

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def stop(self, timeout_s: float = 0.0) -> bool:
        """Ask the thread to end; whether it has within the time. A camera that hangs does not hold its caller up."""
        self._ending.set()
        if self._thread.is_alive() and timeout_s > 0:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def set_listener(self, listener: Listener | None) -> None:
        """Have `listener` called with every frame, on the reader's thread; None for nobody."""
        self._listeners = () if listener is None else (listener,)

    @property
    def n_frames(self) -> int:
        """How many have come so far; the last one is the newest."""
        with self._lock:
            return self._first + len(self._held)

    @property
    def first_index(self) -> int:
        """The oldest that is still held."""
        with self._lock:
            return self._first

    @property
    def has_reference(self) -> bool:
        """Whether there is an untouched reading."""
        return self._reference is not None

    def frame(self, index: int) -> TactileFrame:
        """A frame that is held, also one from before zero was first set; raises FileProblem for one that is gone."""
        frame, first = self._at(index).frame, self._first_zero
        fits = first is not None and frame.reference is None and first.shape == frame.image.shape
        return replace(frame, reference=first) if fits else frame

    def truth(self, index: int) -> Truth | None:
        """What is known of it, where the sensor is simulated."""
        return self._at(index).truth

    def capture_reference(self) -> str:
        """Take the median of the last readings as untouched, from the next one on; what is wrong with it, or ""."""
        images = self._last()
        if len(images) < reference_capture.MIN_FRAMES:
            return f"zero needs {reference_capture.MIN_FRAMES} readings, there are {len(images)}"
        self._reference = reference_capture.compute_median_image(images)
        if self._first_zero is None or self._first_zero.shape != self._reference.shape:
            self._first_zero = self._reference
        spec, sure = sensor_named(self.source.sensor), self._sure_zero
        since = "" if sure is None else reference_capture.check_new_contact(self._reference, sure, spec)
        self._problem = reference_capture.check_motion(images, spec) or since
        if not self._problem:
            self._sure_zero = self._reference
        self._drift = ""
        return self._problem

    def _last(self) -> list[Image | Floats]:
        """The last readings that are of one size."""
        with self._lock:
            images = [held.frame.image for held in list(self._held)[-reference_capture.MAX_FRAMES :]]
        other = next((k for k, image in enumerate(reversed(images)) if image.shape != images[-1].shape), len(images))
        return images[len(images) - other :]

    def status(self) -> ReaderStatus:
        """What is to be said now."""
        now_s = time.monotonic()
        with self._lock:
            arrived = [at_s for at_s in self._arrived if now_s - at_s <= _RATE_OVER_S]
            n, lost = self._first + len(self._held), self._lost
        over_s = min(_RATE_OVER_S, now_s - self._began_s)
        rate = len(arrived) / over_s if over_s > 0 and self._state == "running" else 0.0
        wrong = self._problem or self._drift
        return ReaderStatus(state=self._state, n_frames=n, rate_hz=rate, n_lost=lost, message=wrong)

    def make_recording(self, path: Path) -> Recording:
        """What has come so far as a recording that grows, under a name."""
        sensor = self.source.sensor
        stream = Stream(
            name=sensor, sensor=sensor, n_frames=self.n_frames, frame=self.frame, truth=self.truth, has_truth=True
        )
        mesh, symmetry = self.source.touching_object or (None, None)
        return Recording(
            path=path, format="live sensor", streams=(stream,), notes=(f"watched now: {self.source.title}",),
            object_mesh=mesh, symmetry=symmetry, refresh=lambda: self.make_recording(path),
        )  # fmt: skip

    def _at(self, index: int) -> _Held:
        with self._lock:
            place = index - self._first
            if 0 <= place < len(self._held):
                return self._held[place]
            first, n = self._first, self._first + len(self._held)
        raise FileProblem(
            f"frame {index} is not held any more, only {first} to {n - 1} are; record to keep all", self.source.title
        )

    def _loop(self) -> None:
        opened = False
        while not self._ending.is_set():
            try:
                if not opened:
                    self.source.open()
                    opened, self._number, self._began_s = True, -1, time.monotonic()
                reading = self.source.read()
                if reading is not None:
                    self._take(reading)
            except TouchError as error:
                self._lose(error)
                self.source.close()
                opened = False
                self._ending.wait(RETRY_S)
            except Exception as error:  # noqa: BLE001 - a border: a driver's own errors are a lost sensor too
                self._lose(LiveSourceLost(f"the sensor's driver failed ({type(error).__name__}: {error})"))
                self.source.close()
                opened = False
                self._ending.wait(RETRY_S)
        if opened:
            self.source.close()
        self._state = "stopped"

    def _lose(self, error: TouchError) -> None:
        self._problem = str(error)
        self._state = "lost" if self._held else "looking"

    def _take(self, reading: LiveFrame) -> None:
        image = freeze(reading.image)
        if self._state != "running":
            self._state, self._problem = "running", ""
        if self._reference is not None and image.shape != self._reference.shape:
            (rows, cols), (r, c) = image.shape[:2], self._reference.shape[:2]
            self._problem = f"pictures of {cols} x {rows} px come now, {c} x {r} before; zero is set anew"
            self._reference = None
        with self._lock:
            index = self._first + len(self._held)
            frame = TactileFrame(
                sensor=self.source.sensor, image=image, reference=self._reference, index=index,
                time_s=reading.time_s - self._start_s, origin=f"{self.source.title} [frame {index}]",
            )  # fmt: skip
            self._held.append(_Held(frame=frame, truth=reading.truth))
            self._n_bytes += image.nbytes
            while self._n_bytes > self._most_bytes and len(self._held) > reference_capture.MAX_FRAMES:
                self._n_bytes -= self._held.popleft().frame.image.nbytes
                self._first += 1
            self._arrived.append(reading.time_s)
            while reading.time_s - self._arrived[0] > _RATE_OVER_S:
                self._arrived.popleft()
            if 0 <= self._number < reading.sequence_number - 1:
                self._lost += reading.sequence_number - 1 - self._number
        self._number = reading.sequence_number
        self._check(frame)
        for listener in self._listeners:
            listener(frame, reading.truth)

    def _check(self, frame: TactileFrame) -> None:
        """Set the first zero by itself; now and then see whether it still fits."""
        if self._reference is None:
            if len(self._last()) >= reference_capture.AUTO_CAPTURE_FRAMES:
                self.capture_reference()
        elif frame.time_s - self._checked_s > _CHECK_EVERY_S:
            self._checked_s = frame.time_s
            self._drift = reference_capture.check_drift(frame.image, self._reference, _spec(frame.sensor))


def _spec(name: str) -> SensorSpec:
    return sensor_named(name)
