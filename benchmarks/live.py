"""How many frames a second of a live sensor are shown, and how old; and of a recording's frames?

    python -m benchmarks.live --json FILE

A stream of 30 Hz, contacts half of the time, by worker processes at three rates; the peer is one
process that searches every pose anew. Errors are those against that cold, full result: mean
difference of the translated membrane. Rates are of this machine as busy as it is: processor time
of a frame does not depend on that, and the load is noted.
"""

from __future__ import annotations

import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.harness.command import run_benchmarks
from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.timing import Requirement, Timing, build_measurement, summarize_times
from pipeline.io.live.reader import LiveReader
from pipeline.io.live.source import LiveFrame
from pipeline.io.live.source_parsing import FRAMES_PER_CYCLE, SimulatedSource
from pipeline.io.mounts import mount, unmount
from pipeline.translation.live_translation import LiveTranslation
from pipeline.translation.translate import Request, Translation, open_translation

NEEDS = "a machine without other work: ten minutes"
_SOURCE_HZ = 30.0
_SECONDS = 30.0
_WARM_UP_S = 20.0  # until every worker has opened, compiled and answered
_N_COMPARED = 12  # frames computed again, cold
# of two recordings of a slide, whose difference does not hold the start of the processes
_FEW_FRAMES = 8
_N_FRAMES = 48
_LIVE = Path("live:/benchmark")
# (source, target, frames a second asked for)
_PAIRS = (("gelslim", "soft_bubble", 20.0), ("digit", "gelslim", 25.0))


class _StoredSource:
    """A simulated sensor whose images are ready: it takes no time of the processor."""

    touching_object = None

    def __init__(self, sensor: str) -> None:
        simulated = SimulatedSource(sensor=sensor, tool="cross", rate_hz=_SOURCE_HZ)
        frames = [simulated._get_frame(index)[0] for index in range(FRAMES_PER_CYCLE)]
        self._images = [frame.image for frame in frames]
        self.touching_object = simulated.touching_object
        self.sensor = sensor
        self.title = simulated.title
        self._start_s = 0.0
        self._number = 0

    def open(self) -> None:
        self._start_s = time.monotonic()

    def read(self) -> LiveFrame:
        due_s = self._start_s + self._number / _SOURCE_HZ
        time.sleep(max(0.0, due_s - time.monotonic()))
        self._number += 1
        image = self._images[self._number % len(self._images)]
        now_s = time.monotonic()
        return LiveFrame(image=image, time_s=now_s, sequence_number=self._number)

    def close(self) -> None:
        pass


@dataclass(frozen=True, slots=True, kw_only=True)
class _Watched:
    rate_hz: float  # of frames shown
    source_hz: float
    age: Timing
    error_mm: float  # of the membrane, against the cold full result
    left_out: str


def measure() -> BenchmarkResult:
    rows = []
    notes = [f"load {os.getloadavg()[0]:.1f} at the start, {os.cpu_count()} cores"]
    for source, target, bar_hz in _PAIRS:
        reader = LiveReader(_StoredSource(source))
        mount(_LIVE, lambda reader=reader: reader.make_recording(_LIVE))
        reader.start()
        while not reader.has_reference:
            time.sleep(0.01)
        translation = open_translation(Request(recording=_LIVE, target=target))
        try:
            peer = _watch_alone(translation, reader)
            for rate_hz in (0.0, 15.0, 30.0):
                done = _watch(translation, reader, rate_hz)
                aim = f"{rate_hz:g} Hz" if rate_hz else "best quality"
                share = f"{done.rate_hz:.1f} of the source's {done.source_hz:.1f} Hz"
                rows.append(
                    build_measurement(
                        f"{source} to {target}, {aim}: ms between frames shown, {share}",
                        ours=Timing(median_ms=1e3 / max(done.rate_hz, 1e-3), p95_ms=math.nan),
                        ours_error=done.error_mm,
                        unit="mm",
                        bar=Requirement(max_ms=1e3 / bar_hz),
                        peer="one process, cold",
                        peer_timing=Timing(
                            median_ms=1e3 / max(peer.rate_hz, 1e-3), p95_ms=math.nan
                        ),
                        peer_error=0.0,
                    )
                )
                rows.append(
                    build_measurement(
                        f"{source} to {target}, {aim}: age when shown",
                        ours=done.age,
                        ours_error=done.error_mm,
                        unit="mm",
                        bar=Requirement(max_ms=80.0),
                        peer="one process, cold",
                        peer_timing=peer.age,
                        peer_error=0.0,
                    )
                )
                notes.append(f"{source} to {target}, {aim}: {done.left_out or 'all computed'}")
        finally:
            unmount(_LIVE)
            reader.stop(1.0)
    rows.extend(_measure_recording(notes))
    notes.append(f"load {os.getloadavg()[0]:.1f} at the end")
    return BenchmarkResult(title="Live", unit="mm", rows=tuple(rows), notes=tuple(notes))


def _watch(translation: Translation, reader: LiveReader, rate_hz: float) -> _Watched:
    live = LiveTranslation(translation, reader, rate_hz=rate_hz)
    try:
        _poll(live, _WARM_UP_S)
        first = reader.n_frames
        shown = _poll(live, _SECONDS)
        source_hz = (reader.n_frames - first) / _SECONDS
    finally:
        live.close()
    touched = [one for one in shown if one.results["depth"].state != "skipped"]
    errors_mm = [
        _compare(translation, one.frame, one.results["touch_depth"].output)
        for one in touched[:: max(1, len(touched) // _N_COMPARED)]
    ]
    return _Watched(
        rate_hz=len(shown) / _SECONDS,
        source_hz=source_hz,
        age=summarize_times([1e3 * one.age_s for one in shown] or [math.nan]),
        error_mm=float(np.mean(errors_mm)) if errors_mm else math.nan,
        left_out=live.plan.describe(),
    )


def _poll(live: LiveTranslation, seconds: float) -> list:
    shown = []
    ends_s = time.monotonic() + seconds
    while time.monotonic() < ends_s:
        shown += live.poll(0.02)
    return shown


def _compare(translation: Translation, frame, found) -> float:
    cold = translation.evaluate(frame, ["touch_depth"])["touch_depth"].output
    return float(np.nanmean(np.abs(found.depth_mm - cold.depth_mm)))


def _watch_alone(translation: Translation, reader: LiveReader) -> _Watched:
    """The newest frame in this process, every pose searched."""
    ages_ms = []
    frame = reader.frame(reader.n_frames - 1)
    translation.evaluate(frame)
    ends_s = time.monotonic() + _SECONDS
    while time.monotonic() < ends_s:
        while reader.n_frames - 1 == frame.index:
            time.sleep(0.002)
        frame = reader.frame(reader.n_frames - 1)
        translation.evaluate(frame)
        ages_ms.append(1e3 * reader.measure_age_s(frame))
    return _Watched(
        rate_hz=len(ages_ms) / _SECONDS,
        source_hz=_SOURCE_HZ,
        age=summarize_times(ages_ms),
        error_mm=0.0,
        left_out="",
    )


def _measure_recording(notes: list[str]):
    """Processor ms a touched frame of `translate --all`, with sheets as before and without."""
    sensors = ("--sensors", "gelslim,soft_bubble", "--tools", "cross", "--sequence", "slide")
    choices = {
        "with sheets": (),
        "without sheets": ("--no-sheets",),
        "without sheets, poses followed": ("--no-sheets", "--follow"),
    }
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in choices}
    with tempfile.TemporaryDirectory() as folder:
        for n_frames in (_FEW_FRAMES, _N_FRAMES):
            slide = Path(folder, f"slide_{n_frames}.h5")
            _run("simulate", *sensors, "--poses", n_frames, "--out", slide)
            for name, more in choices.items():
                out = Path(folder, f"{n_frames} {name}")
                words = ("--sensor", "gelslim", "--target", "soft_bubble", "--all", "--jobs", 2)
                taken[name].append(_run("translate", slide, *words, *more, "--out", out))
    # the start of the processes is in both runs
    cpu_ms = {
        name: 1e3 * (many[0] - few[0]) / (_N_FRAMES - _FEW_FRAMES)
        for name, (few, many) in taken.items()
    }
    for name in ("without sheets", "without sheets, poses followed"):
        rate_hz = _N_FRAMES / taken[name][1][1]
        notes.append(f"translate --all {name}: {rate_hz:.1f} frames a second with its start")
        yield build_measurement(
            f"translate --all, {name}: processor ms a touched frame",
            ours=Timing(median_ms=cpu_ms[name], p95_ms=math.nan),
            ours_error=math.nan,
            unit="mm",
            bar=Requirement(max_ms=100.0),
            peer="with sheets",
            peer_timing=Timing(median_ms=cpu_ms["with sheets"], p95_ms=math.nan),
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
    file = Path(sys.argv[2]) if sys.argv[1:2] == ["--json"] else None
    sys.exit(run_benchmarks(["live"], file, None, strict=False))
