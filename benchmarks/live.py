"""How many frames a second of a live sensor are shown, and how old; and of a recording's frames?

    python -m benchmarks.live --json FILE
    python -m benchmarks.live --recording 10    (minutes; the row of the recording alone)

A stream of 30 Hz, contacts half of the time, translated by T2D2 and by worker processes at two
rates; the peer is one process that does all of every frame anew. Errors are those of the source's
depth against the truth; how far the generated membrane is from the cold one is noted. Rates are of
this machine as busy as it is: processor time of a frame does not depend on that, and the load is
noted.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.harness.command import run_benchmarks
from benchmarks.harness.results import BenchmarkResult, Measurement
from benchmarks.harness.timing import Requirement, Timing, build_measurement, summarize_times
from pipeline.core.values.frames import TactileFrame, Truth
from pipeline.core.values.results import DepthMap
from pipeline.io import hdf5
from pipeline.io.live.reader import LiveReader
from pipeline.io.live.recorder import LiveRecorder
from pipeline.io.live.source import LiveFrame
from pipeline.io.live.source_parsing import FRAMES_PER_CYCLE, SimulatedSource
from pipeline.io.mounts import mount, unmount
from pipeline.translation.live_translation import LiveTranslation
from pipeline.translation.translate import Request, Translation, open_translation

NEEDS = "a machine without other work: five minutes"
_SOURCE_HZ = 30.0
_ROUTE = "t2d2"
_SECONDS = 24.0
_PEER_SECONDS = 12.0
# until every worker has compiled and answered, and the light is fitted: touched frames, seconds
_WARM_UP = 60, 40.0
_N_COMPARED = 10  # frames computed again, cold
# of two recordings of a slide, whose difference does not hold the start of the processes
_FEW_FRAMES = 8
_N_FRAMES = 56
_LIVE = Path("live:/benchmark")
_PAIRS = (("gelslim", "soft_bubble", 20.0), ("digit", "gelslim", 25.0))
_PEER = "one process, cold"
_NO_PEER = "none"
_RECORDED_HZ = 60.0
_RECORDED_S = 15.0
_NOISE_GREY = 0.8  # standard deviation: ten minutes take 10 GB


class _StoredSource:
    """A simulated sensor whose images are ready: it takes no time of the processor."""

    def __init__(self, sensor: str) -> None:
        simulated = SimulatedSource(sensor=sensor, tool="cross", rate_hz=_SOURCE_HZ)
        # its own images, in place of ones with new noise
        moments = [simulated._get_frame(index) for index in range(FRAMES_PER_CYCLE)]
        self._images = [frame.image for frame, _ in moments]
        self._truths = [truth for _, truth in moments]
        self.touching_object = simulated.touching_object
        self.sensor = sensor
        self.title = simulated.title
        self._start_s = 0.0
        self._number = 0

    @property
    def touched_share(self) -> float:
        """Share of the frames with contact."""
        touched = [
            truth is not None and truth.contact is not None and bool(truth.contact.any())
            for truth in self._truths
        ]
        return sum(touched) / len(touched)

    def get_truth(self, index: int) -> Truth | None:
        """The truth of a frame of the reader."""
        return self._truths[index % FRAMES_PER_CYCLE]

    def open(self) -> None:
        self._start_s = time.monotonic()

    def read(self) -> LiveFrame:
        due_s = self._start_s + self._number / _SOURCE_HZ
        time.sleep(max(0.0, due_s - time.monotonic()))
        image = self._images[self._number % FRAMES_PER_CYCLE]
        self._number += 1
        now_s = time.monotonic()
        return LiveFrame(image=image, time_s=now_s, sequence_number=self._number)

    def close(self) -> None:
        pass


@dataclass(frozen=True, slots=True, kw_only=True)
class _Shown:
    """What is kept of a translated frame."""

    frame: TactileFrame
    age_ms: float
    is_touched: bool
    depth: DepthMap | None = None  # None: not one of those that are compared
    membrane: DepthMap | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Watched:
    rate_hz: float  # of frames shown
    split: str
    age: Timing
    error_mm: float  # of the source's depth, against the truth
    cold_error_mm: float
    away_mm: float  # of the membrane, from the cold one
    left_out: str = ""


def measure() -> BenchmarkResult:
    rows: list[Measurement] = []
    notes = [f"load {os.getloadavg()[0]:.1f} at the start, {os.cpu_count()} cores, route {_ROUTE}"]
    for source, target, bar_hz in _PAIRS:
        stored = _StoredSource(source)
        reader = LiveReader(stored)
        mount(_LIVE, lambda reader=reader: reader.make_recording(_LIVE))
        reader.start()
        while not reader.has_reference:
            time.sleep(0.01)
        translation = open_translation(Request(recording=_LIVE, target=target, route=_ROUTE))
        try:
            peer = _watch_alone(translation, reader, stored)
            notes.append(f"{source} to {target}, {_PEER}: {peer.rate_hz:.1f} Hz, {peer.split}")
            for rate_hz in (0.0, bar_hz):
                done = _watch(translation, reader, stored, rate_hz)
                name = f"{source} to {target}, {f'{rate_hz:g} Hz' if rate_hz else 'best quality'}"
                rows += _build_rows(name, done, peer, bar_hz)
                notes.append(
                    f"{name}: {done.left_out or 'all computed'}; {done.split}; the membrane is "
                    f"{done.away_mm:.2g} mm from the cold one"
                )
            if not any(row.peer == _NO_PEER for row in rows):
                rows.append(_record(translation, reader))
        finally:
            unmount(_LIVE)
            reader.stop(1.0)
    rows.extend(_measure_recording(notes))
    notes.append(f"load {os.getloadavg()[0]:.1f} at the end")
    return BenchmarkResult(title="Live", unit="mm", rows=tuple(rows), notes=tuple(notes))


def _build_rows(name: str, done: _Watched, peer: _Watched, bar_hz: float) -> Iterator[Measurement]:
    def compare(what: str, measured: Callable[[_Watched], Timing], bar: Requirement) -> Measurement:
        return build_measurement(
            f"{name}: {what}",
            ours=measured(done),
            ours_error=done.error_mm,
            unit="mm",
            bar=bar,
            peer=_PEER,
            peer_timing=measured(peer),
            peer_error=done.cold_error_mm,
        )

    yield compare(
        f"ms between frames shown, {done.rate_hz:.1f} Hz",
        lambda one: Timing(median_ms=1e3 / max(one.rate_hz, 1e-3), p95_ms=math.nan),
        Requirement(max_ms=1e3 / bar_hz),
    )
    yield compare("age when shown", lambda one: one.age, Requirement(max_ms=80.0))
    yield compare(
        "age when shown, 95th percentile",
        lambda one: Timing(median_ms=one.age.p95_ms, p95_ms=math.nan),
        Requirement(max_ms=200.0),
    )


def _watch(
    translation: Translation, reader: LiveReader, stored: _StoredSource, rate_hz: float
) -> _Watched:
    live = LiveTranslation(translation, reader, rate_hz=rate_hz)
    try:
        n_touched, most_s = _WARM_UP
        _poll(live, most_s, n_touched)
        cpu_s = _read_workers_cpu_s()
        shown = _poll(live, _SECONDS)
        cpu_s = _read_workers_cpu_s() - cpu_s
        left_out = live.plan.describe()
    finally:
        live.close()
    cpu = f"workers used {100.0 * cpu_s / _SECONDS:.0f} % of a core"
    watched = _summarize(translation, stored, shown, _SECONDS)
    return replace(watched, left_out=left_out, split=f"{watched.split}; {cpu}")


def _poll(live: LiveTranslation, seconds: float, n_touched: int = 1 << 30) -> list[_Shown]:
    """What is shown in some seconds, or until enough of it was touched."""
    shown: list[_Shown] = []
    n = 0
    ends_s = time.monotonic() + seconds
    step = max(1, round(seconds * _SOURCE_HZ / (3 * _N_COMPARED)))
    while time.monotonic() < ends_s and n < n_touched:
        for one in live.poll(0.02):
            results = one.results
            is_touched = results["depth"].state != "skipped"
            n += is_touched
            is_compared = is_touched and n % step == 0
            shown.append(
                _Shown(
                    frame=one.frame,
                    age_ms=1e3 * one.age_s,
                    is_touched=is_touched,
                    depth=results["depth"].output if is_compared else None,
                    membrane=results["touch_depth"].output if is_compared else None,
                )
            )
    return shown


def _read_workers_cpu_s() -> float:
    """Processor time so far of the processes that this one has started."""
    ticks = 0
    for process in multiprocessing.active_children():
        words = Path(f"/proc/{process.pid}/stat").read_text().split()
        ticks += int(words[13]) + int(words[14])
    return ticks / os.sysconf("SC_CLK_TCK")


def _summarize(
    translation: Translation, stored: _StoredSource, shown: list[_Shown], seconds: float
) -> _Watched:
    errors = [
        [_compare(one.depth, truth), _compare(cold["depth"].output, truth), away_mm]
        for one in shown
        if one.depth is not None and one.membrane is not None
        if (truth := stored.get_truth(one.frame.index)) is not None
        for cold in [translation.evaluate(replace(one.frame, context_frames=()), ["touch_depth"])]
        for away_mm in [_compare(one.membrane, cold["touch_depth"].output)]
    ]
    error_mm, cold_error_mm, away_mm = np.mean(errors or [[math.nan] * 3], axis=0)
    share = stored.touched_share
    n_touched = sum(one.is_touched for one in shown)
    touched_hz = n_touched / (seconds * share)
    untouched_hz = (len(shown) - n_touched) / (seconds * (1.0 - share))
    return _Watched(
        rate_hz=len(shown) / seconds,
        split=f"touched {touched_hz:.1f} Hz in {share:.0%} of the time, else {untouched_hz:.1f} Hz",
        age=summarize_times([one.age_ms for one in shown] or [math.nan]),
        error_mm=float(error_mm),
        cold_error_mm=float(cold_error_mm),
        away_mm=float(away_mm),
    )


def _compare(found: DepthMap, wanted: DepthMap | Truth) -> float:
    assert wanted.indentation_mm is not None
    return float(np.nanmean(np.abs(found.indentation_mm - wanted.indentation_mm)))


def _watch_alone(translation: Translation, reader: LiveReader, stored: _StoredSource) -> _Watched:
    """The newest frame in this process, all of it anew."""
    shown: list[_Shown] = []
    frame = reader.frame(reader.n_frames - 1)
    translation.evaluate(frame)
    ends_s = time.monotonic() + _PEER_SECONDS
    while time.monotonic() < ends_s:
        while reader.n_frames - 1 == frame.index:
            time.sleep(0.002)
        frame = reader.frame(reader.n_frames - 1)
        is_touched = translation.evaluate(frame)["depth"].state != "skipped"
        age_ms = 1e3 * reader.measure_age_s(frame)
        shown.append(_Shown(frame=frame, age_ms=age_ms, is_touched=is_touched))
    return _summarize(translation, stored, shown, _PEER_SECONDS)


class _NumberedSource:
    """Images of 640 x 480 px at 60 Hz; the first pixel of each is its number."""

    touching_object = None
    title = "numbered"
    sensor = "digit"

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        self._image = rng.normal(120.0, _NOISE_GREY, (640, 480, 3)).astype(np.uint8)
        self._start_s = 0.0
        self.number = 0

    def open(self) -> None:
        self._start_s = time.monotonic()

    def read(self) -> LiveFrame:
        time.sleep(max(0.0, self._start_s + self.number / _RECORDED_HZ - time.monotonic()))
        self.number += 1
        image = self._image.copy()
        image[0, 0] = [self.number >> 16 & 255, self.number >> 8 & 255, self.number & 255]
        return LiveFrame(image=image, time_s=time.monotonic(), sequence_number=self.number)

    def close(self) -> None:
        pass


def _record(
    translation: Translation, reader: LiveReader, seconds: float = _RECORDED_S
) -> Measurement:
    """Frames lost by a recording beside a live chain that takes all it can."""
    source = _NumberedSource()
    with tempfile.TemporaryDirectory() as folder:
        fast = LiveReader(source)
        recorder = LiveRecorder(Path(folder, "numbered.h5"), fast)
        live = LiveTranslation(translation, reader)
        try:
            _poll(live, _WARM_UP[1], 10)
            fast.start()
            for _ in range(max(1, round(seconds / _RECORDED_S))):
                _poll(live, min(seconds, _RECORDED_S))
        finally:
            live.close()
            fast.stop(1.0)
        recorder.close(60.0)
        lost = _count_gaps(recorder.path)
    return build_measurement(
        f"recording 640 x 480 px at 60 Hz beside the live chain: frames lost of "
        f"{recorder.n_written + lost}",
        ours=Timing(median_ms=1e3 * seconds / max(recorder.n_written, 1), p95_ms=math.nan),
        ours_error=float(lost),
        unit="frames",
        bar=Requirement(max_error=0.0),
        peer=_NO_PEER,
    )


def _count_gaps(path: Path) -> int:
    """Frames that a file lacks between its first and its last number."""
    with closing(hdf5.read(path)) as recording:
        stream = recording.streams[0]
        ends = [stream.frame(index).image[0, 0].tolist() for index in (0, stream.n_frames - 1)]
        first, last = (red << 16 | green << 8 | blue for red, green, blue in ends)
        return last - first + 1 - stream.n_frames


def _record_alone(minutes: float) -> None:
    """Print the frames lost by a recording of some minutes, and the memory that it takes."""
    stored = _StoredSource("digit")
    reader = LiveReader(stored)
    mount(_LIVE, lambda: reader.make_recording(_LIVE))
    reader.start()
    while not reader.has_reference:
        time.sleep(0.01)
    translation = open_translation(Request(recording=_LIVE, target="gelslim", route=_ROUTE))
    row = _record(translation, reader, 60.0 * minutes)
    reader.stop(1.0)
    most_kb = [
        resource.getrusage(who).ru_maxrss
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    ]
    memory = f"at most {most_kb[0] >> 10} MB, a worker {most_kb[1] >> 10} MB"
    print(f"{row.question}: {row.ours_error:g}; {memory}; load {os.getloadavg()[0]:.1f}")


def _measure_recording(notes: list[str]) -> Iterator[Measurement]:
    """Processor ms a touched frame of `translate --all`, and frames a second of both cores."""
    sensors = ("--sensors", "gelslim,soft_bubble", "--tools", "cross", "--sequence", "slide")
    choices = {"each frame alone": ("--no-follow",), "followed": ()}
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in choices}
    words = ("--sensor", "gelslim", "--target", "soft_bubble", "--route", _ROUTE, "--all")
    with tempfile.TemporaryDirectory() as folder:
        for n_frames in (_FEW_FRAMES, _N_FRAMES):
            slide = Path(folder, f"slide_{n_frames}.h5")
            _run("simulate", *sensors, "--poses", n_frames, "--out", slide)
            for name, more in choices.items():
                out = Path(folder, f"{n_frames} {name}")
                asked = (*words, *more, "--no-sheets", "--jobs", 2, "--out", out)
                taken[name].append(_run("translate", slide, *asked))
    cpu_ms, wall_ms = (
        {
            name: 1e3 * (many[k] - few[k]) / (_N_FRAMES - _FEW_FRAMES)
            for name, (few, many) in taken.items()
        }
        for k in (0, 1)
    )
    for name in choices:
        notes.append(
            f"translate --all, {name}: {_N_FRAMES / taken[name][1][1]:.1f} frames a second with "
            "its start"
        )
        for what, ms, bar_ms in (("processor ms", cpu_ms, 100.0), ("ms", wall_ms, 50.0)):
            yield build_measurement(
                f"translate --all, {name}: {what} a touched frame",
                ours=Timing(median_ms=ms[name], p95_ms=math.nan),
                ours_error=math.nan,
                unit="mm",
                bar=Requirement(max_ms=bar_ms),
            )


def _run(*words: object) -> tuple[float, float]:
    """(processor s, wall s) of a command of the program."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    started_s = time.monotonic()
    command = [sys.executable, "-m", "pipeline", *(str(word) for word in words)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return cpu_s, time.monotonic() - started_s


if __name__ == "__main__":
    if sys.argv[1:2] == ["--recording"]:
        sys.exit(_record_alone(float(sys.argv[2])))
    file = Path(sys.argv[2]) if sys.argv[1:2] == ["--json"] else None
    sys.exit(run_benchmarks(["live"], file, None, strict=False))
