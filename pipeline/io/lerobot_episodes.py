"""Where the episodes of a LeRobot data set lie in the video files of a camera.

Version 3 keeps several episodes in one file, and each camera begins its files with other episodes:
a table gives the file and the time at which each begins. Version 2 keeps a file an episode. The
frames of an episode are those nearest to its times at the data set's rate.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.arrays import Doubles, Indices, freeze
from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.files import read_bytes, require_file
from pipeline.core.read_budget import require_budget

NO_FRAME = -1
_KEYS = ("episode_index", "length")
_PLACE_KEYS = ("chunk_index", "file_index", "from_timestamp")  # of videos/<camera>/
# times; images are compressed already, and fold no further
_MAX_FOLDED = 20
_MOST_FOLDED_BYTES = 1 << 28
# episodes; frames of one
_MAX_ROWS = 1_000_000
_MAX_LENGTH = 10_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
    """The part of a video file that is one episode of a camera."""

    file: Path
    start_s: float  # in the file
    n_frames: int

    def select_frames(self, times_s: Doubles, rate_hz: float) -> Indices:
        """Number in the file of each frame, by the times of the file's frames.

        NO_FRAME where it has none.
        """
        wanted_s = self.start_s + np.arange(self.n_frames) / rate_hz
        after = np.clip(np.searchsorted(times_s, wanted_s), 1, max(len(times_s) - 1, 1))
        around = np.stack([after - 1, np.minimum(after, len(times_s) - 1)])
        gaps_s = np.abs(times_s[around] - wanted_s)
        nearest = np.take_along_axis(around, gaps_s.argmin(axis=0)[None], axis=0)[0]
        nearest[gaps_s.min(axis=0) > 0.5 / rate_hz] = NO_FRAME
        return freeze(nearest.astype(np.int32))


def import_parquet() -> tuple[Any, Any]:
    """(`pyarrow.parquet`, the class of its errors).

    Raises SettingProblem where it is not installed.
    """
    try:
        from pyarrow import ArrowException, parquet
    except ImportError as error:
        raise SettingProblem(
            "parquet is read by pyarrow, which is not installed; pip install pyarrow"
        ) from error
    return parquet, ArrowException


def require_group_budget(group: Any, table: Path) -> None:
    """Raise FileProblem where a group of rows (its metadata) states columns that unfold beyond
    the budget.
    """
    for column in map(group.column, range(group.num_columns)):
        if column.total_uncompressed_size > _MAX_FOLDED * column.total_compressed_size:
            require_budget(
                column.total_uncompressed_size, "a group of rows", table, most=_MOST_FOLDED_BYTES
            )


def list_videos(root: Path, name: str) -> list[Path]:
    """The video files of a camera in order; raises FileProblem for none."""
    files = sorted(p for p in (root / "videos").rglob("*.mp4") if name in p.relative_to(root).parts)
    if not files:
        raise FileProblem(f"the data set lacks the videos of {name}", root, field=name)
    return files


def list_episodes(root: Path, name: str) -> list[Episode]:
    """The episodes of a camera in order; [] where no table lists them. Raises FileProblem."""
    files = list_videos(root, name)
    found = dict[int, Episode]()
    keys = [f"videos/{name}/{key}" for key in _PLACE_KEYS]
    for row in _read_rows(root, (*_KEYS, *keys)):
        number = int(row["episode_index"])
        start_s = row.get(keys[2], 0.0)
        stem = f"file-{int(row[keys[1]]):03d}" if keys[1] in row else f"episode_{number:06d}"
        chunk = f"chunk-{int(row[keys[0]]):03d}" if keys[0] in row else ""
        file = next((p for p in files if p.stem == stem and (not chunk or chunk in p.parts)), None)
        if file is None:
            raise FileProblem(
                f"the data set lacks the video {stem} of {name} with episode {number}",
                root,
                field=name,
            )
        if start_s < 0 or not 0 < row["length"] <= _MAX_LENGTH:
            raise FileProblem(
                f"episode {number} of {name} has no valid place in its video", root, field=name
            )
        found[number] = Episode(file=file, start_s=start_s, n_frames=int(row["length"]))
    return [found[number] for number in sorted(found)]


def _read_rows(root: Path, columns: Sequence[str]) -> list[dict[str, float]]:
    """The rows of the table of episodes with what they have of these columns."""
    tables = sorted((root / "meta" / "episodes").rglob("*.parquet"))
    lines = root / "meta" / "episodes.jsonl"
    at = lines
    problem = "the table of episodes cannot be read"
    try:
        rows = list[dict[str, Any]]()
        for at in tables:
            rows += _read_table(at, columns)
        if not tables and lines.is_file():
            text = read_bytes(lines, "the table of episodes").decode("utf-8")
            rows = [json.loads(line) for line in text.splitlines() if line.strip()]
        numbers = [
            {key: float(row[key]) for key in columns if row.get(key) is not None} for row in rows
        ]
    except (ValueError, TypeError, AttributeError, OSError, RecursionError) as error:
        raise FileProblem(problem, at) from error
    if not all(
        set(_KEYS) <= row.keys() and np.isfinite(list(row.values())).all() for row in numbers
    ):
        raise FileProblem(f"{problem}: an episode lacks its number or length", at)
    return numbers


def _read_table(table: Path, columns: Sequence[str]) -> list[dict[str, Any]]:
    parquet, error_class = import_parquet()
    require_file(table, "the table of episodes")
    try:
        file = parquet.ParquetFile(table)
        if file.metadata.num_rows > _MAX_ROWS:
            raise FileProblem(f"the table of episodes states {file.metadata.num_rows} rows", table)
        for group in range(file.metadata.num_row_groups):
            require_group_budget(file.metadata.row_group(group), table)
        return file.read(columns=[c for c in columns if c in file.schema_arrow.names]).to_pylist()
    except error_class as error:
        raise FileProblem("the table of episodes cannot be read", table) from error
