"""What a recording is, and whether its units, frames and colours make sense."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from pipeline.base.errors import TouchError
from pipeline.base.progress import SILENT, Progress
from pipeline.inspection import stream_checks as inspection
from pipeline.inspection import synchrony
from pipeline.inspection.object_checks import check_mesh, measure_contact_offset_mm
from pipeline.inspection.stream_checks import Check
from pipeline.recordings import open_recording
from pipeline.recordings.formats import DepthUnit
from pipeline.sensors.spec import SensorSpec, list_sensor_names
from pipeline.sensors.spec import load_sensor as sensor_spec
from pipeline.values.frames import Recording, Stream, TactileFrame, Truth

_MARKS = {"pass": "ok  ", "fail": "FAIL", "unknown": "?   "}


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamReport:
    """One stream in figures."""

    name: str
    sensor: str  # "" = not known
    n_frames: int
    rows: int  # 0 = no frame could be read
    cols: int
    dtype: str
    duration_s: float  # NaN = no times
    rate_hz: float
    truth: tuple[str, ...]  # fields known of some frame


@dataclass(frozen=True, slots=True, kw_only=True)
class InspectionReport:
    """What was found; `checks` are in the order of the streams."""

    path: Path
    format: str
    streams: tuple[StreamReport, ...]
    has_mesh: bool
    checks: tuple[Check, ...]
    notes: tuple[str, ...] = ()

    @property
    def has_passed(self) -> bool:
        """Whether no check failed; what could not be checked does not count."""
        return all(check.state != "fail" for check in self.checks)


def inspect_recording(
    path: Path,
    *,
    sensor: str = "",
    reference: Path | None = None,
    depth_unit: DepthUnit = "auto",
    progress: Progress = SILENT,
) -> InspectionReport:
    """Read every frame once and say what is there; damaged frames are listed, not raised.

    Raises TouchError only when the recording as a whole cannot be opened.
    """
    with closing(open_recording(path, sensor=sensor, reference=reference, depth_unit=depth_unit)) as recording:
        found = [_stream(recording, s, _spec(s.sensor, sensor), progress) for s in recording.streams]
        checks = [check for _, several in found for check in several]
        checks += inspection.check_pairings(recording)
        checks += _orders(recording)
        if recording.object_mesh is not None:
            checks += check_mesh(recording.object_mesh, str(recording.path))
        return InspectionReport(
            path=recording.path,
            format=recording.format,
            streams=tuple(report for report, _ in found),
            has_mesh=recording.object_mesh is not None,
            checks=tuple(checks),
            notes=recording.notes,
        )


def format_report_lines(report: InspectionReport) -> list[str]:
    """The report as lines for a terminal."""
    out = [f"{report.path}: {report.format}" + (", with the mesh of the object" if report.has_mesh else "")]
    for s in report.streams:
        size = f"{s.cols} x {s.rows} px {s.dtype}" if s.rows else "no readable frame"
        timing = "no times" if math.isnan(s.duration_s) else f"{s.duration_s:.2f} s at {s.rate_hz:.1f} Hz"
        truth = f"truth: {', '.join(s.truth)}" if s.truth else "no truth"
        out.append(f"  {s.name}: {s.sensor or 'unknown sensor'}, {s.n_frames} frames, {size}, {timing}, {truth}")
    out += [f"  {_MARKS[c.state]} {c.name}: {c.text}" for c in report.checks]
    return out + [f"  note: {note}" for note in report.notes]


def _orders(recording: Recording) -> Iterator[Check]:
    """Whether what two streams felt belongs together, where they tell."""
    for one, other in combinations(recording.streams, 2):
        order = synchrony.compare_streams(one, other)
        if order is not None:
            good = f"of {order.n_moments} moments, strong ones and places of one are those of the other"
            state = "pass" if order.warning is None else ("fail" if order.lag_frames else "unknown")
            text = good if order.warning is None else f"{order.warning}: '{recording.path}'"
            yield Check(name=f"{one.name} with {other.name}", state=state, text=text)


def _spec(name: str, said: str) -> SensorSpec | None:
    """The description of a stream's sensor: one of the catalogue, or the one that the user brought."""
    own = sensor_spec(said) if said else None
    if own is not None and own.name == name:
        return own
    return sensor_spec(name) if name in list_sensor_names() else None


def _stream(
    recording: Recording, stream: Stream, spec: SensorSpec | None, progress: Progress
) -> tuple[StreamReport, list[Check]]:
    tally = inspection.StreamChecker(stream.name, str(recording.path), spec)
    times: list[float] = []
    known: set[str] = set()
    first: TactileFrame | None = None
    for index in range(stream.n_frames):
        progress.step(index / stream.n_frames, f"frame {index + 1} of {stream.n_frames} of {stream.name}")
        frame, truth, problem = _read(stream, index)
        if problem:
            tally.add_problem(problem)
        if frame is not None:
            first = first or frame
            times.append(frame.time_s)
            tally.add_frame(frame)
        if truth is not None:
            known |= {n for n in ("indentation_mm", "contact", "sensor_from_object") if getattr(truth, n) is not None}
            tally.add_truth(index, truth)
            if recording.object_mesh is not None and spec is not None:
                tally.add_contact_offset(index, measure_contact_offset_mm(truth, spec, recording.object_mesh))
    duration_s, rate_hz = _timing(times)
    rows, cols = first.image.shape[:2] if first is not None else (0, 0)
    report = StreamReport(
        name=stream.name, sensor=stream.sensor, n_frames=stream.n_frames, rows=rows, cols=cols,
        dtype="" if first is None else f"{first.image.dtype} {'depth in mm' if first.is_depth else 'RGB'}",
        duration_s=duration_s, rate_hz=rate_hz, truth=tuple(sorted(known)),
    )  # fmt: skip
    return report, tally.summarize_checks(times)


def _read(stream: Stream, index: int) -> tuple[TactileFrame | None, Truth | None, str]:
    """A frame and its truth as far as they can be read, and what was wrong."""
    problems: list[str] = []
    frame: TactileFrame | None = None
    truth: Truth | None = None
    try:
        frame = stream.frame(index)
    except TouchError as error:
        problems.append(str(error))
    try:
        truth = stream.truth(index)
    except TouchError as error:
        problems.append(str(error))
    return frame, truth, "; ".join(problems)


def _timing(times: Sequence[float]) -> tuple[float, float]:
    known = np.asarray([t for t in times if math.isfinite(t)])
    if len(known) < 2 or known[-1] <= known[0]:
        return math.nan, math.nan
    duration_s = float(known[-1] - known[0])
    return duration_s, (len(known) - 1) / duration_s
