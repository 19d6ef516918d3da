"""Cameras of a LeRobot data set (v3, and v2 of the same file kinds) as streams: videos, or images in parquet tables."""

import re
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate, islice
from pathlib import Path
from typing import Annotated, Any

import msgspec

from pipeline.base.arrays import Image
from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.base.files import read_json, require_file
from pipeline.base.read_budget import require_budget
from pipeline.base.typed_data import Name, convert
from pipeline.recordings.encoded_images import decode_rgb
from pipeline.recordings.formats import ReadOptions, RecordingFiles
from pipeline.recordings.image_sequence import make_stream
from pipeline.recordings.video import VideoDecoder
from pipeline.values.frames import Recording, Stream

_INFO = Path("meta") / "info.json"
_MAX_FOLDED, _MOST_FOLDED_BYTES = 20, 1 << 28  # times; images are compressed already, and fold no further
_TACTILE = re.compile(r"tactile|touch|digit|gel", re.IGNORECASE)  # in the name of a camera


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
    """All tactile cameras, or all cameras where none is named so; episodes follow each other.

    Raises FileProblem, and SettingProblem where a package for parquet is missing.
    """
    path = files.path
    info = convert(read_json(path / _INFO, "the data set's description"), _Info, "the data set", path / _INFO)
    cameras = {name: feature.dtype for name, feature in info.features.items() if feature.dtype in ("video", "image")}
    chosen = [name for name in cameras if _TACTILE.search(name)] or list(cameras)
    if not chosen:
        raise FileProblem("the data set has no camera", path / _INFO, field="features")
    streams, notes, sequences = list[Stream](), list[str](), list[_Videos]()
    for name in chosen:
        if cameras[name] == "video":
            images = _Videos(path, name, info.fps)
            sequences.append(images)
        else:
            images = _TableImages(path, name, info.fps)
        stream, about = make_stream(images, path, options, name=name)
        streams.append(stream)
        notes += about
    left_out = [name for name in cameras if name not in chosen]
    notes += [f"cameras without touch are left out: {', '.join(left_out)}"] if left_out else []
    notes += [f"{info.total_episodes} episodes follow each other"] if info.total_episodes > 1 else []

    def close() -> None:
        for images in sequences:
            images.close()

    return Recording(path=path, format="LeRobot data set", streams=tuple(streams), close=close,
                     notes=(*files.notes, *dict.fromkeys(notes)))  # fmt: skip


class _Videos:
    """The frames of a camera's videos, one file after the other."""

    def __init__(self, root: Path, name: str, rate_hz: float) -> None:
        files = sorted(p for p in (root / "videos").rglob("*.mp4") if name in p.relative_to(root).parts)
        if not files:
            raise FileProblem(f"the data set lacks the videos of {name}", root, field=name)
        self._videos, self._rate_hz = [VideoDecoder(file) for file in files], rate_hz
        self._ends = list(accumulate(video.n_frames for video in self._videos))

    @property
    def n_frames(self) -> int:
        """Number of frames of all files."""
        return self._ends[-1]

    def frame(self, index: int) -> Image:
        """(rows, cols, 3) RGB."""
        at = bisect_right(self._ends, index)
        return self._videos[at].frame(index - (self._ends[at - 1] if at else 0))

    def time_s(self, index: int) -> float:
        """Time by the data set's rate."""
        return index / self._rate_hz

    def close(self) -> None:
        """Release the files."""
        for video in self._videos:
            video.close()


@dataclass(frozen=True, slots=True)
class _Rows:
    """A part of a parquet file."""

    file: Path
    group: int
    end: int  # number of images up to its last row


class _TableImages:
    """Images in a column of parquet tables, read one by one: a group of rows unfolds to any size."""

    def __init__(self, root: Path, name: str, rate_hz: float) -> None:
        try:
            from pyarrow import ArrowException, parquet
        except ImportError as error:
            raise SettingProblem(
                "images in parquet are read by pyarrow, which is not installed; pip install pyarrow"
            ) from error
        self._parquet: Any = parquet
        self._error, self._name, self._rate_hz, self._rows = ArrowException, name, rate_hz, list[_Rows]()
        end = 0
        self._open: tuple[int, int, Iterator[Any]] = -1, 0, iter(())  # group, next row, batches from there
        for file in sorted((root / "data").rglob("*.parquet")):
            require_file(file, "the table", most_bytes=1 << 50)
            try:
                about = parquet.ParquetFile(file).metadata
            except (ArrowException, OSError) as error:
                raise FileProblem("the table cannot be read", file) from error
            for group in range(about.num_row_groups):
                end += about.row_group(group).num_rows
                self._rows.append(_Rows(file, group, end))
        if not end:
            raise FileProblem(f"the data set lacks the images of {name}", root, field=name)

    @property
    def n_frames(self) -> int:
        """Number of rows of all tables."""
        return self._rows[-1].end

    def frame(self, index: int) -> Image:
        """(rows, cols, 3) RGB."""
        at = bisect_right([rows.end for rows in self._rows], index)
        part = self._rows[at]
        try:
            cell = self._read_cell(at, index - (self._rows[at - 1].end if at else 0))
        except (self._error, OSError, LookupError, StopIteration) as error:
            raise FileProblem(f"the table's column {self._name} cannot be read", part.file) from error
        content = cell.get("bytes") if isinstance(cell, dict) else cell
        if not isinstance(content, bytes):
            raise FileProblem(f"frame {index} of {self._name} holds no image", part.file, field=f"frame {index}")
        return decode_rgb(content, f"frame {index}", part.file)

    def _read_cell(self, at: int, row: int) -> Any:
        """The cell in a row of a group; the rows before it are passed, from the last one that was read."""
        group, next_row, cells = self._open
        if group != at or next_row > row:
            part = self._rows[at]
            file = self._parquet.ParquetFile(part.file)
            about = file.metadata.row_group(part.group)
            for column in map(about.column, range(about.num_columns)):
                if column.total_uncompressed_size > _MAX_FOLDED * column.total_compressed_size:
                    require_budget(
                        column.total_uncompressed_size, "a group of rows", part.file, most=_MOST_FOLDED_BYTES
                    )
            next_row, cells = 0, file.iter_batches(1, row_groups=[part.group], columns=[self._name])
        self._open = at, row + 1, cells
        return next(islice(cells, row - next_row, None)).column(0)[0].as_py()

    def time_s(self, index: int) -> float:
        """Time by the data set's rate."""
        return index / self._rate_hz
