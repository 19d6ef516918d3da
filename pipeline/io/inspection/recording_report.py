"""Report on a recording: its content, and checks of units, frames and colours."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TypeVar

import numpy as np

from pipeline.core.errors import StageWarning, TouchError
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import LARGEST_MM, SMALLEST_MM, Mesh
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import Recording, Stream, TactileFrame, Truth
from pipeline.core.values.pairing import compute_interval_s, pair_frames
from pipeline.io import open_recording
from pipeline.io.formats import DepthUnit
from pipeline.io.inspection import synchrony
from pipeline.io.inspection.stream_checks import Check, StreamChecker, check_pairings
from pipeline.io.inspection.synchrony import ContactSignature
from pipeline.sensors.spec import SensorSpec, list_sensor_names, load_sensor

T = TypeVar("T")
_TRUTH_FIELDS = ("indentation_mm", "contact", "sensor_from_object")
_STATE_LABELS = {"pass": "ok  ", "fail": "FAIL", "unknown": "?   "}


@frozen
class StreamReport:
    """Content of one stream."""

    name: str
    sensor: str  # "" = not known
    n_frames: int
    rows: int  # 0 = no frame can be read
    cols: int
    dtype: str
    duration_s: float  # NaN = no times
    rate_hz: float
    truth: tuple[str, ...]  # fields known for at least one frame


@frozen
class InspectionReport:
    """Content and checks of a recording; `checks` are in the order of the streams."""

    path: Path
    format: str
    streams: tuple[StreamReport, ...]
    has_mesh: bool
    checks: tuple[Check, ...]
    notes: tuple[str, ...] = ()

    @property
    def has_passed(self) -> bool:
        """Whether no check failed; unknown ones do not count."""
        return all(check.state != "fail" for check in self.checks)


def inspect_recording(
    path: Path,
    *,
    sensor: str = "",
    stream: str = "",
    reference: Path | None = None,
    reference_frames: str = "",
    depth_unit: DepthUnit = "auto",
    progress: Progress = SILENT,
) -> InspectionReport:
    """Read every frame once and report content and checks of all streams or one.

    Damaged frames fail a check.

    Raises TouchError only where the recording cannot be opened.
    """
    with closing(
        open_recording(
            path,
            sensor=sensor,
            stream=stream,
            reference=reference,
            reference_frames=reference_frames,
            depth_unit=depth_unit,
        )
    ) as recording:
        shown = (recording.stream(stream),) if stream else recording.streams
        signatures: dict[str, dict[int, ContactSignature]] = {s.name: {} for s in shown}
        reports = [
            _inspect_stream(
                recording, s, _find_sensor(s.sensor, sensor), signatures[s.name], progress
            )
            for s in shown
        ]
        checks = [check for _, stream_checks in reports for check in stream_checks]
        checks += check_pairings(recording)
        checks += _check_grasps(recording)
        checks += _check_moments(recording, shown, signatures)
        if recording.object_mesh is not None:
            checks += [
                check(recording.object_mesh, str(recording.path))
                for check in (_check_size, _check_surface)
            ]
        return InspectionReport(
            path=recording.path,
            format=recording.format,
            streams=tuple(report for report, _ in reports),
            has_mesh=recording.object_mesh is not None,
            checks=tuple(checks),
            notes=recording.notes,
        )


def format_report_lines(report: InspectionReport) -> list[str]:
    """The report as lines for a terminal."""
    out = [
        f"{report.path}: {report.format}"
        + (", with the mesh of the object" if report.has_mesh else "")
    ]
    for s in report.streams:
        size = f"{s.cols} x {s.rows} px {s.dtype}" if s.rows else "no readable frame"
        timing = (
            "no times"
            if math.isnan(s.duration_s)
            else f"{s.duration_s:.2f} s at {s.rate_hz:.1f} Hz"
        )
        truth = f"truth: {', '.join(s.truth)}" if s.truth else "no truth"
        out.append(
            f"  {s.name}: {s.sensor or 'unknown sensor'}, {s.n_frames} frames, {size}, {timing}, "
            f"{truth}"
        )
    out += [f"  {_STATE_LABELS[c.state]} {c.name}: {c.text}" for c in report.checks]
    return out + [f"  note: {note}" for note in report.notes]


def _check_grasps(recording: Recording) -> Iterator[Check]:
    """Check that the files of every grasp belong together; names those that do not."""
    if not recording.grasps:
        return
    problems = [
        f"{grasp.name}: {problem}"
        for index, grasp in enumerate(recording.grasps)
        if (problem := recording.find_pair_problem(index))
    ]
    good = f"the files of {len(recording.grasps)} grasps belong together"
    yield Check(
        name="grasps", state="fail" if problems else "pass", text="; ".join(problems) or good
    )


def _check_moments(
    recording: Recording,
    streams: Sequence[Stream],
    signatures: Mapping[str, Mapping[int, ContactSignature]],
) -> Iterator[Check]:
    """Checks that streams have times in common, and recorded the same touches where this can be
    decided.

    Each stream is checked with those it has a known transform to, and with the first: all pairs
    would take a time that grows with the square of their number.
    """
    by_name = {s.name: s for s in streams}
    known = [
        (p.source, p.target) for p in recording.pairings if {p.source, p.target} <= by_name.keys()
    ]
    for names in dict.fromkeys([*((streams[0].name, s.name) for s in streams[1:]), *known]):
        one, other = (by_name[name] for name in names)
        pairs = pair_frames(one, other)
        name = f"{one.name} with {other.name}"
        if pairs.note:
            state = "fail" if isinstance(pairs.note, StageWarning) else "unknown"
            yield Check(name=name, state=state, text=f"{pairs.note}: '{recording.path}'")
        result = synchrony.compare_moments(pairs, signatures[one.name], signatures[other.name])
        if result is not None and result.warning is not None:
            state = "fail" if result.lag_frames else "unknown"
            yield Check(name=name, state=state, text=f"{result.warning}: '{recording.path}'")
        elif result is not None:
            text = f"strength and place of {result.n_moments} moments agree"
            yield Check(name=name, state="pass", text=text)


def _find_sensor(name: str, stated: str) -> SensorSpec | None:
    """The description of a stream's sensor: the stated one if the names agree, else a known one,
    else None.
    """
    if stated and load_sensor(stated).name == name:
        return load_sensor(stated)
    return load_sensor(name) if name in list_sensor_names() else None


def _inspect_stream(
    recording: Recording,
    stream: Stream,
    spec: SensorSpec | None,
    signatures: dict[int, ContactSignature],
    progress: Progress,
) -> tuple[StreamReport, list[Check]]:
    """Content and checks of one stream; fills in the signatures of its frames by their numbers."""
    checker = StreamChecker(stream.name, str(recording.path), spec)
    times: list[float] = []
    known: set[str] = set()
    first: TactileFrame | None = None
    for index in range(stream.n_frames):
        progress.step(
            index / stream.n_frames, f"frame {index + 1} of {stream.n_frames} of {stream.name}"
        )
        frame, truth, problem = _read_frame(stream, index)
        if problem:
            checker.add_problem(problem)
        if frame is not None:
            first = first or frame
            times.append(frame.time_s)
            checker.add_frame(frame)
            signatures[index] = synchrony.compute_frame_signature(frame)
        if truth is not None:
            known |= {n for n in _TRUTH_FIELDS if getattr(truth, n) is not None}
            checker.add_truth(index, truth)
            if recording.object_mesh is not None and spec is not None:
                checker.add_contact_offset(
                    index, measure_contact_offset_mm(truth, spec, recording.object_mesh)
                )
    duration_s, rate_hz = _compute_timing(times)
    rows, cols = first.image.shape[:2] if first is not None else (0, 0)
    report = StreamReport(
        name=stream.name,
        sensor=stream.sensor,
        n_frames=stream.n_frames,
        rows=rows,
        cols=cols,
        dtype=""
        if first is None
        else f"{first.image.dtype} {'depth in mm' if first.is_depth else 'RGB'}",
        duration_s=duration_s,
        rate_hz=rate_hz,
        truth=tuple(sorted(known)),
    )
    return report, checker.summarize_checks(times)


def _read_frame(stream: Stream, index: int) -> tuple[TactileFrame | None, Truth | None, str]:
    """(frame, truth, problems), as far as they can be read."""
    problems: list[str] = []

    def attempt(read: Callable[[int], T]) -> T | None:
        try:
            return read(index)
        except TouchError as error:
            problems.append(str(error))
            return None

    return attempt(stream.frame), attempt(stream.truth), "; ".join(problems)


def _compute_timing(times: Sequence[float]) -> tuple[float, float]:
    known = np.asarray([t for t in times if math.isfinite(t)])
    if len(known) < 2 or known[-1] <= known[0]:
        return math.nan, math.nan
    return float(known[-1] - known[0]), 1.0 / compute_interval_s(known)


def measure_contact_offset_mm(truth: Truth, sensor: SensorSpec, mesh: Mesh) -> float:
    """Distance in mm from the median contact point to the bounding box of the object at its true
    pose; 0 = inside.

    Also 0 where the truth has no contact or pose, or another image size.
    """
    indentation = truth.indentation_mm
    contact = truth.contact
    pose = truth.sensor_from_object
    if (
        indentation is None
        or contact is None
        or pose is None
        or indentation.shape != sensor.camera.shape
    ):
        return 0.0
    points = sensor.camera.back_project(sensor.rest_depth_mm - indentation)[
        contact & np.isfinite(indentation)
    ]
    if not len(points):
        return 0.0
    centre = rigid.apply(rigid.invert(pose), np.median(points.astype(np.float64), axis=0))
    low = mesh.vertices_mm.min(axis=0)
    high = mesh.vertices_mm.max(axis=0)
    return float(np.linalg.norm(np.maximum(np.maximum(low - centre, centre - high), 0.0)))


def _check_size(mesh: Mesh, path: str) -> Check:
    extent = np.ptp(mesh.vertices_mm[np.unique(mesh.triangles)], axis=0)
    text = f"{' x '.join(f'{e:.3g}' for e in extent)} mm, {len(mesh.triangles)} triangles"
    is_good = SMALLEST_MM <= extent.max() <= LARGEST_MM
    if not is_good:
        text = f"the mesh is {text}; objects measure {SMALLEST_MM:g} to {LARGEST_MM:g} mm: '{path}'"
    return Check(name="object size", state="pass" if is_good else "fail", text=text)


def _check_surface(mesh: Mesh, path: str) -> Check:
    """Each edge must occur once in each direction; then no part is open, doubled or flipped."""
    t = mesh.triangles.astype(np.int64)
    n = len(mesh.vertices_mm)
    start, end = t.ravel(), np.roll(t, -1, axis=1).ravel()
    forward = start * n + end
    n_open = int((~np.isin(forward, end * n + start)).sum())
    n_doubled = len(forward) - len(np.unique(forward))
    volume_mm3 = float(np.linalg.det(mesh.vertices_mm[t]).sum()) / 6.0
    if n_open:
        problem = f"{n_open} of its edges have no neighbour: it has holes and no inside"
    elif n_doubled:
        problem = (
            f"{n_doubled} of its edges occur twice in one direction: triangles are doubled "
            "or flipped"
        )
    elif volume_mm3 <= 0:
        problem = f"its triangles face inward (volume {volume_mm3:.3g} mm³); flip them"
    else:
        text = f"closed and facing outward, {volume_mm3:.3g} mm³"
        return Check(name="object surface", state="pass", text=text)
    return Check(name="object surface", state="fail", text=f"the mesh: {problem}: '{path}'")
