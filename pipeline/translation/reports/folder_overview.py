"""What the recordings of a folder hold, one row each, kept in the user's cache between two starts.

A row is made of what the inspection reads: sensors, frames, failed checks; and of the change of
some frames from their reference, spread over the recording: the share with contact, and the first
touch.
"""

import math
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import field
from functools import partial
from pathlib import Path

import numpy as np

from pipeline.core.arrays import Image
from pipeline.core.digests import compute_fingerprint
from pipeline.core.disk_store import load_or_make, load_stored
from pipeline.core.errors import FileProblem, StageWarning, TouchError
from pipeline.core.frozen import frozen
from pipeline.core.progress import SILENT, Progress, SubProgress
from pipeline.core.values.frames import Recording, TactileFrame
from pipeline.io import open_recording
from pipeline.io.folder_contents import find_recording
from pipeline.io.inspection.recording_report import inspect_recording
from pipeline.sensors.spec import SensorSpec, list_sensor_titles, load_sensor
from pipeline.translation.colour_limits import round_up
from pipeline.translation.error_attribution import DEFAULT_METRIC
from pipeline.translation.frame_selection import compare_with_reference
from pipeline.translation.translate import Translation
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import make_recorded_preview

THUMBNAIL_PX = 64, 44  # largest width and height
_MOST_ROWS = 4000  # of all folders, in the cache
_LEAST_LIMIT_MM = 1.0  # of the colours of a bubble without a touch
_ROWS, _WORST = "recordings", "worst_frames"  # folders in the cache
_CODE = ("pipeline.translation.reports.folder_overview",)


@frozen
class RecordingRow:
    """One recording; with a `problem` it cannot be read, and nothing else is known."""

    sensors: str = ""  # titles
    n_frames: int = 0  # of the first stream
    contact_share: float = math.nan  # of the frames that were looked at; NaN without a reference
    first_touch: int = -1  # frame of the picture; -1 = no contact
    warnings: str = ""  # one a line
    problem: str = ""
    thumbnail: Image = field(default_factory=lambda: np.zeros((0, 0, 3), np.uint8))

    @property
    def n_warnings(self) -> int:
        """Number of warnings."""
        return len(self.warnings.splitlines())


@frozen
class WorstFrame:
    """The frame of a recording with the largest error of its default translation."""

    frame: int = -1  # -1 = no frame has a known error
    error_mm: float = math.nan


def list_recordings(folder: Path) -> tuple[Path, ...]:
    """Return the recordings of a folder, files or folders; () where it is one itself, or none."""
    try:
        return find_recording(folder).alternatives if folder.is_dir() else ()
    except (FileProblem, OSError):
        return ()


def summarise_recording(path: Path, progress: Progress = SILENT) -> RecordingRow:
    """Return the row of a recording, from the cache where it is unchanged."""
    make = partial(_make_row, path, progress)
    return load_or_make(RecordingRow, _key(path), _CODE, make, _ROWS, _MOST_ROWS)


def load_row(path: Path) -> RecordingRow | None:
    """Return the row of a recording from the cache; None where it is not there."""
    return load_stored(RecordingRow, _key(path), _CODE, _ROWS)


def find_worst_frame(
    path: Path, open_path: Callable[[Path], Translation], progress: Progress = SILENT
) -> WorstFrame:
    """Return the frame with the largest error against the recorded truth, from the cache where
    the recording is unchanged; `open_path` opens its translation.
    """
    make = partial(_rank_frames, path, open_path, progress)
    return load_or_make(WorstFrame, _key(path), _CODE, make, _WORST, _MOST_ROWS)


def load_worst_frame(path: Path) -> WorstFrame | None:
    """Return the worst frame of a recording from the cache; None where it is not there."""
    return load_stored(WorstFrame, _key(path), _CODE, _WORST)


def _rank_frames(
    path: Path, open_path: Callable[[Path], Translation], progress: Progress
) -> WorstFrame:
    worst = WorstFrame()
    try:
        with open_path(path) as opened:
            other = opened.target_stream
            stage = DEFAULT_METRIC.partition(".")[0]
            if other is None or not other.has_truth or stage not in opened.stages:
                return worst
            for index in range(opened.n_frames):
                part = SubProgress(progress, index / opened.n_frames, 1.0 / opened.n_frames)
                results = opened.evaluate(index, [stage], part)
                error_mm = opened.compute_metrics(results, index).get(DEFAULT_METRIC, math.nan)
                if math.isfinite(error_mm) and not error_mm <= worst.error_mm:  # NaN at first
                    worst = WorstFrame(frame=index, error_mm=error_mm)
    except TouchError:
        return worst  # which its row, or opening it, says
    return worst


def _key(path: Path) -> tuple[str, tuple[int | str, ...]]:
    return str(path.absolute()), _stamp(path)


def _stamp(path: Path) -> tuple[int | str, ...]:
    """Return what changes with the contents of a recording; a large file is not read for it."""
    if path.is_dir():
        return (compute_fingerprint(path),)
    try:
        found = path.stat()
    except OSError:
        return ()
    return found.st_mtime_ns, found.st_size


def _make_row(path: Path, progress: Progress) -> RecordingRow:
    try:
        report = inspect_recording(path, progress=progress)
        failed = [check.text for check in report.checks if check.state == "fail"]
        noted = [note for note in report.notes if isinstance(note, StageWarning)]
        with closing(open_recording(path)) as recording:
            return _look_at(recording, [*failed, *noted])
    except TouchError as error:
        return RecordingRow(problem=str(error))


def _look_at(recording: Recording, warnings: Iterable[str]) -> RecordingRow:
    """Return the row of an open recording: its first stream is the source."""
    stream = recording.streams[0]
    titles = list_sensor_titles()
    known = load_sensor(stream.sensor) if stream.sensor in titles else None
    limit = math.inf if known is None else known.limits.no_contact_change
    changes = [(frame, float(change.max())) for frame, change in compare_with_reference(stream)]
    touched = [(frame, change) for frame, change in changes if change >= limit]
    peak = max((change for _, change in touched), default=0.0)
    shown = (touched or changes)[0][0] if changes else stream.frame(0)
    return RecordingRow(
        sensors=", ".join(
            dict.fromkeys(titles.get(s.sensor, "unknown sensor") for s in recording.streams)
        ),
        n_frames=stream.n_frames,
        contact_share=len(touched) / len(changes) if changes and known else math.nan,
        first_touch=touched[0][0].index if touched else -1,
        warnings="\n".join(" ".join(warning.split()) for warning in warnings),
        thumbnail=_draw_thumbnail(shown, known, peak),
    )


def _draw_thumbnail(frame: TactileFrame, sensor: SensorSpec | None, peak: float) -> Image:
    """Return the small image of a frame; of depth, by a scale that the recording's peak fills."""
    import cv2

    if frame.is_depth and sensor is None:
        return RecordingRow().thumbnail
    pixels = np.asarray(frame.image, np.uint8)
    if sensor is not None:
        limit_mm = round_up(max(peak, _LEAST_LIMIT_MM)) if frame.is_depth else 0.0
        display = DisplayParams(bubble_limit_mm=limit_mm)
        pixels = make_recorded_preview(frame, sensor, display)[0].pixels
    rows, cols = pixels.shape[:2]
    share = min(THUMBNAIL_PX[0] / cols, THUMBNAIL_PX[1] / rows)
    size = max(1, round(share * cols)), max(1, round(share * rows))
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
