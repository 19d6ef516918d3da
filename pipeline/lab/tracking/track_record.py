"""A track as rows, and as files: a table of its frames, its summary, and the fused surface."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from pipeline.core.arrays import Doubles
from pipeline.core.errors import FileProblem
from pipeline.core.files import (
    MOST_TEXT_BYTES,
    check_folder,
    format_json,
    read_bytes,
    read_json,
    write_together,
)
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh, load_mesh
from pipeline.core.typed_data import FileName, Name, Number, convert

TrackState = Literal["tracked", "lost", "no contact"]
# whose membrane can be followed
TRACKED_STAGES = {"depth": "source", "touch_depth": "generated touch"}
TABLE = "track.csv"
SUMMARY = "track.json"
PATCH = "patch.ply"
MOTION = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
_COLUMNS = (
    "frame",
    "state",
    "part",
    "key_frame",
    *MOTION,
    "std_mm",
    "std_deg",
    "overlap",
    "agreement",
    "not_measured",
)
_Count = Annotated[int, Meta(ge=0, le=10**9)]


@frozen
class TrackError:
    """Error of a track against true poses."""

    path_mm: float  # length of the true path of the contact's centre
    turned_deg: float  # sum of the true rotations between frames
    drift_mm: float  # largest error of the contact centre's position
    drift_deg: float  # largest error of the rotation
    n_frames: int


@frozen
class TrackRow:
    """One frame of a track; numbers are NaN where the object was not tracked."""

    frame: _Count
    state: TrackState
    part: _Count  # parts do not know of each other
    key_frame: _Count | None = None  # frame that it was registered to
    # motion since the first frame of the part: translation, and rotation vector
    x_mm: Number = math.nan
    y_mm: Number = math.nan
    z_mm: Number = math.nan
    rx_deg: Number = math.nan
    ry_deg: Number = math.nan
    rz_deg: Number = math.nan
    std_mm: Number = math.nan  # predicted
    std_deg: Number = math.nan
    overlap: Number = math.nan  # share of the key frame's contact that is in view
    agreement: Number = math.nan  # inlier share
    not_measured: Name = ""  # directions

    @property
    def sensor_from_start(self) -> Doubles | None:
        """Transform (4, 4) that takes the object's points of the part's first frame to this one.

        None if unknown.
        """
        motion = [getattr(self, name) for name in MOTION]
        return rigid.from_parts(motion[:3], motion[3:]) if all(map(math.isfinite, motion)) else None


@frozen
class TrackRecord:
    """What `tactoscope track` writes and the window shows."""

    stage: str  # whose membrane was followed: depth or touch_depth
    rows: tuple[TrackRow, ...]
    key_frames: tuple[int, ...] = ()
    n_loops: int = 0  # closed
    error: TrackError | None = None  # against true poses, where they are known
    patch: Mesh | None = None  # in the sensor frame of the first part's first frame
    problems: tuple[str, ...] = ()  # frames that could not be read, which count as lost, and why

    def count(self, state: TrackState) -> int:
        """Return the number of frames in a state."""
        return sum(row.state == state for row in self.rows)

    @property
    def n_parts(self) -> int:
        """Number of parts that do not know of each other."""
        return len({row.part for row in self.rows if row.state == "tracked"})

    @property
    def weak_directions(self) -> tuple[str, ...]:
        """Directions that are not measured in some frame."""
        return tuple(
            sorted({one for row in self.rows for one in row.not_measured.split("; ") if one})
        )


def format_table(rows: Sequence[TrackRow]) -> str:
    """Return the rows as CSV: state, motion since the first frame, predicted standard
    deviations, weak directions.
    """
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(_COLUMNS)
    for row in rows:
        table.writerow([_format_cell(getattr(row, name)) for name in _COLUMNS])
    return text.getvalue()


def _format_cell(value: float | str | None) -> str:
    if isinstance(value, float):
        return f"{value:.5f}" if math.isfinite(value) else ""
    return "" if value is None else str(value)


def write_record(folder: Path, record: TrackRecord) -> None:
    """Write the three files into a folder, all or none; a surface only where one could be fused."""
    check_folder(folder)
    summary = {
        "stage": record.stage,
        "frames": len(record.rows),
        "lost": record.count("lost"),
        "parts": record.n_parts,
        "key_frames": list(record.key_frames),
        "closed_loops": record.n_loops,
        "error": None if record.error is None else asdict(record.error),
        "problems": record.problems,
    }
    contents = {TABLE: format_table(record.rows).encode(), SUMMARY: format_json(summary).encode()}
    if record.patch is not None:
        contents[PATCH] = format_patch(record.patch)
    write_together(folder, contents, "the track", read_record)
    if record.patch is None:
        (folder / PATCH).unlink(missing_ok=True)  # of an earlier track


def format_patch(patch: Mesh) -> bytes:
    """Return a mesh in mm as a binary PLY."""
    rows: Any = np.empty(len(patch.triangles), dtype=[("n", "u1"), ("corners", "<i4", 3)])
    rows["n"] = 3
    rows["corners"] = patch.triangles
    head = (
        f"ply\nformat binary_little_endian 1.0\ncomment {patch.name}, mm\n"
        f"element vertex {len(patch.vertices_mm)}\nproperty float x\nproperty float y\nproperty "
        "float z\n"
        f"element face {len(patch.triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return (
        head.encode("ascii", "replace") + patch.vertices_mm.astype("<f4").tobytes() + rows.tobytes()
    )


class _Summary(msgspec.Struct, kw_only=True):
    """The part of track.json that its table does not hold."""

    stage: Name
    key_frames: tuple[_Count, ...] = ()
    closed_loops: _Count = 0
    error: TrackError | None = None
    problems: tuple[FileName, ...] = ()  # sentences that name a file


def is_track_folder(path: Path) -> bool:
    """Whether a folder holds a track; opens no file."""
    return all((path / name).is_file() for name in (TABLE, SUMMARY))


def read_record(folder: Path) -> TrackRecord:
    """Read the files that `write_record` wrote; raises FileProblem."""
    summary = convert(
        read_json(folder / SUMMARY, "the track's summary"),
        _Summary,
        "the track's summary",
        folder / SUMMARY,
    )
    patch = folder / PATCH
    return TrackRecord(
        stage=summary.stage,
        rows=_read_rows(folder / TABLE),
        key_frames=summary.key_frames,
        n_loops=summary.closed_loops,
        error=summary.error,
        problems=summary.problems,
        patch=load_mesh(patch, unit="mm") if patch.is_file() else None,
    )


def _read_rows(path: Path) -> tuple[TrackRow, ...]:
    try:
        lines = read_bytes(path, "the track", MOST_TEXT_BYTES).decode("utf-8").splitlines()
        cells: list[Mapping[str, Any]] = list(csv.DictReader(lines))
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileProblem(f"the track is no table ({error})", path) from error
    given = [
        {name: value for name, value in row.items() if value and name in _COLUMNS} for row in cells
    ]
    try:
        # texts of a table as numbers
        return tuple(msgspec.convert(given, list[TrackRow], strict=False))
    except msgspec.ValidationError as error:
        raise FileProblem(
            f"the track cannot be used ({str(error).replace('`', '')})", path
        ) from error
