"""Recordings written while they are watched: readable at any moment, also after a kill.

The library's single-writer-multiple-readers mode keeps the file in order on disk between any two writes. All datasets
must be there before it begins, so that the first frame decides what the others may hold.
"""

from __future__ import annotations

import time
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from pipeline.base.errors import FileProblem
from pipeline.base.files import file_to_grow, prepare_folder_for
from pipeline.recordings import hdf5_layout as layout
from pipeline.recordings.hdf5_layout import Coding
from pipeline.recordings.hdf5_writer import RecordingWriter
from pipeline.values.frames import TactileFrame, Truth

FLUSH_EVERY_S = 0.25  # what a kill may cost


class LiveRecordingWriter(RecordingWriter):
    """A recording at its very place from the first frame on."""

    def _begin(self, path: Path, coding: Coding, depth_step_mm: float) -> None:
        prepare_folder_for(path)
        if path.exists():
            raise FileProblem("a file of this name is there already and is kept; choose another", path)
        super()._begin(path, coding, depth_step_mm)
        self._flushed_s = 0.0

    def _place_of(self, path: Path) -> BinaryIO:
        return self._place.enter_context(file_to_grow(path, "the recording"))

    def append(self, stream: str, frame: TactileFrame, truth: Truth | None = None) -> None:
        """Add one frame to the one stream; raises ShapeError when it does not agree with the first."""
        super().append(stream, frame, truth)
        if not self._file.swmr_mode:
            self._file.swmr_mode = True
        now_s = time.monotonic()
        if now_s - self._flushed_s > FLUSH_EVERY_S:
            self._flushed_s = now_s
            self._file.flush()

    def __exit__(
        self, _kind: type[BaseException] | None, error: BaseException | None, _at: TracebackType | None
    ) -> None:
        """What was recorded stays, whatever ended it; a file without a single frame goes."""
        with self._place:
            empty = self._file is None or not len(self._file.get("streams", ()))
            if self._file is not None:
                self._file.close()
                layout.truncate_to_size(self._beside)
            if empty:
                self._path.unlink(missing_ok=True)
            if error is not None:
                raise error
