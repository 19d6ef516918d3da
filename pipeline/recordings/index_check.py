"""Check of frame numbers before a reader is called."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from pipeline.base.errors import FileProblem

T = TypeVar("T")


def with_index_check(read: Callable[[int], T], n_frames: int, path: Path) -> Callable[[int], T]:
    """`read` that raises FileProblem for a number outside 0..n_frames-1."""

    def read_checked(index: int) -> T:
        if not 0 <= index < n_frames:
            last = f"frames are 0 to {n_frames - 1}" if n_frames else "it has no frames"
            raise FileProblem(f"there is no frame {index}, {last}", path, field=f"frame {index}")
        return read(index)

    return read_checked
