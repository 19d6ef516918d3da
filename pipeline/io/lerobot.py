"""Cameras of a LeRobot data set (v3, and v2 of the same file kinds) as streams: videos, or
images in parquet tables.
"""

import json
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from pipeline.core.arrays import Doubles, Image, Indices, freeze
from pipeline.core.errors import FileProblem, SettingProblem, StageWarning
from pipeline.core.files import (
    close_on_error,
    read_bytes,
    read_json,
    require_budget,
    require_file,
)
from pipeline.core.frozen import frozen
from pipeline.core.typed_data import Name, convert
from pipeline.core.values.frames import Recording
from pipeline.core.values.pairing import find_nearest
from pipeline.io.formats import ReadOptions, RecordingFiles
from pipeline.io.gel_streams import ImageSource, make_film, make_streams
from pipeline.io.image_files import decode_rgb
from pipeline.io.video import VideoDecoder

_INFO = Path("meta") / "info.json"


class _Feature(msgspec.Struct):
    dtype: Name


class _Info(msgspec.Struct):
    """What is read of meta/info.json."""

    fps: Annotated[float, msgspec.Meta(gt=0, le=1e6)]
    features: dict[Name, _Feature]
    total_episodes: Annotated[int, msgspec.Meta(ge=0)] = 0


def is_data_set(folder: Path) -> bool:
    """Whether a folder is a LeRobot data set."""
    return (folder / _INFO).is_file()


def read(files: RecordingFiles, options: ReadOptions) -> Recording:
    """All cameras that record touch, see `gel_streams.make_streams`; episodes follow each other.

    Raises FileProblem, and SettingProblem where a package for parquet is missing.
    """
    path = files.path
    info = convert(
        read_json(path / _INFO, "the data set's description"), _Info, "the data set", path / _INFO
    )
    kinds = {
        name: one.dtype for name, one in info.features.items() if one.dtype in ("video", "image")
    }
    if not kinds:
        raise FileProblem("the data set has no camera", path / _INFO)
    closing = ExitStack()

    def open_camera(name: str) -> ImageSource:
        if kinds[name] == "image":
            table = _TableImages(path, name)
            n, frame = table.n_frames, table.frame
        else:
            n, frame = _open_videos(path, name, info.fps, closing)
        return make_film(path, n, frame, np.arange(n) / info.fps)

    with close_on_error(closing.close):
        streams, notes = make_streams(
            {name: partial(open_camera, name) for name in kinds}, path, options
        )
    if len({stream.n_frames for stream in streams}) > 1:
        counts = ", ".join(f"{stream.name} {stream.n_frames}" for stream in streams)
        notes += (
            StageWarning(
                f"the cameras have different numbers of frames ({counts}), so that pairs may be "
                "wrong"
            ),
        )
    if info.total_episodes > 1:
        notes += (f"{info.total_episodes} episodes follow each other",)
    return Recording(
        path=path,
        format="LeRobot data set",
        streams=streams,
        close=closing.close,
        notes=notes,
    )


def _open_videos(
    root: Path, name: str, rate_hz: float, closing: ExitStack
) -> tuple[int, Callable[[int], Image]]:
    """(number, reader) of the frames of a camera's videos, one episode after the other."""
    episodes = list_episodes(root, name)
    files = list(dict.fromkeys(e.file for e in episodes)) or list_videos(root, name)
    videos = {file: VideoDecoder(file) for file in files}
    for video in videos.values():
        closing.callback(video.close)
    frames = [
        (videos[episode.file], k)
        for episode in episodes
        for k in episode.select_frames(videos[episode.file].times_s, rate_hz).tolist()
    ] or [(video, k) for video in videos.values() for k in range(video.n_frames)]

    def read(index: int) -> Image:
        video, number = frames[index]
        if number == NO_FRAME:
            raise FileProblem(f"the video ends before frame {index}", root)
        return video.frame(number)

    return len(frames), read


@dataclass(frozen=True, slots=True)
class _Rows:
    """A part of a parquet file."""

    file: Path
    group: int
    end: int  # number of images up to its last row


class _TableImages:
    """Images in a column of parquet tables, read one by one: a group of rows unfolds to any
    size.
    """

    def __init__(self, root: Path, name: str) -> None:
        parquet, error_class = self._parquet, self._error = import_parquet()
        self._name = name
        self._rows = list[_Rows]()
        end = 0
        # group, next row, batches from there
        self._open: tuple[int, int, Iterator[Any]] = -1, 0, iter(())
        for file in sorted((root / "data").rglob("*.parquet")):
            require_file(file, "the table", most_bytes=1 << 50)
            try:
                about = parquet.ParquetFile(file).metadata
            except (error_class, OSError) as error:
                raise FileProblem("the table cannot be read", file) from error
            for group in range(about.num_row_groups):
                end += about.row_group(group).num_rows
                self._rows.append(_Rows(file, group, end))
        if not end:
            raise FileProblem(f"the data set lacks the images of {name}", root)
        self.n_frames = end  # rows of all tables

    def frame(self, index: int) -> Image:
        """(rows, cols, 3) RGB."""
        at = bisect_right([rows.end for rows in self._rows], index)
        part = self._rows[at]
        try:
            cell = self._read_cell(at, index - (self._rows[at - 1].end if at else 0))
        except (self._error, OSError, LookupError, StopIteration) as error:
            raise FileProblem(
                f"the table's column {self._name} cannot be read", part.file
            ) from error
        content = cell.get("bytes") if isinstance(cell, dict) else cell
        if not isinstance(content, bytes):
            raise FileProblem(f"frame {index} of {self._name} holds no image", part.file)
        return decode_rgb(content, f"frame {index}", part.file)

    def _read_cell(self, at: int, row: int) -> Any:
        """The cell in a row of a group.

        The rows before it are passed, from the last one that was read.
        """
        group, next_row, cells = self._open
        if group != at or next_row > row:
            part = self._rows[at]
            file = self._parquet.ParquetFile(part.file)
            require_group_budget(file.metadata.row_group(part.group), part.file)
            next_row = 0
            cells = file.iter_batches(1, row_groups=[part.group], columns=[self._name])
        self._open = at, row + 1, cells
        return next(islice(cells, row - next_row, None)).column(0)[0].as_py()


NO_FRAME = -1
_KEYS = ("episode_index", "length")
_PLACE_KEYS = ("chunk_index", "file_index", "from_timestamp")  # of videos/<camera>/
# times; images are compressed already, and fold no further
_MAX_FOLDED = 20
_MOST_FOLDED_BYTES = 1 << 28
# episodes; frames of one
_MAX_ROWS = 1_000_000
_MAX_LENGTH = 10_000_000


@frozen
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
        nearest, gaps_s = find_nearest(times_s, wanted_s)
        nearest[gaps_s > 0.5 / rate_hz] = NO_FRAME
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
        raise FileProblem(f"the data set lacks the videos of {name}", root)
    return files


def list_episodes(root: Path, name: str) -> list[Episode]:
    """The episodes of a camera in order; [] where no table lists them. Raises FileProblem."""
    files = list_videos(root, name)
    found = dict[int, Episode]()
    chunk_key, file_key, start_key = keys = [f"videos/{name}/{key}" for key in _PLACE_KEYS]
    for row in _read_rows(root, (*_KEYS, *keys)):
        number = int(row["episode_index"])
        start_s = row.get(start_key, 0.0)
        stem = f"file-{int(row[file_key]):03d}" if file_key in row else f"episode_{number:06d}"
        chunk = f"chunk-{int(row[chunk_key]):03d}" if chunk_key in row else ""
        file = next((p for p in files if p.stem == stem and (not chunk or chunk in p.parts)), None)
        if file is None:
            raise FileProblem(
                f"the data set lacks the video {stem} of {name} with episode {number}",
                root,
            )
        if start_s < 0 or not 0 < row["length"] <= _MAX_LENGTH:
            raise FileProblem(f"episode {number} of {name} has no valid place in its video", root)
        found[number] = Episode(file=file, start_s=start_s, n_frames=int(row["length"]))
    return [episode for _, episode in sorted(found.items())]


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
