"""Record a live sensor on a thread of its own, so that a slow disk delays nothing else."""

import queue
import threading
import time
from contextlib import closing
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from pipeline.core.errors import FileProblem, TouchError
from pipeline.core.files import check_folder_for, open_growing_file, read_back
from pipeline.core.values.frames import TactileFrame, Truth
from pipeline.io import hdf5
from pipeline.io import hdf5_layout as layout
from pipeline.io.hdf5_layout import Coding
from pipeline.io.hdf5_writer import Effort, RecordingWriter
from pipeline.io.live.reader import LiveReader

FLUSH_INTERVAL_S = 0.25  # largest loss by a kill


class LiveRecordingWriter(RecordingWriter):
    """A recording written directly to its path, which can be read at any moment, also after a kill.

    HDF5's single-writer-multiple-readers mode keeps the file consistent on disk. All datasets must
    exist before it begins, so that the first frame of each stream decides what the others may hold.
    """

    n_streams = 1  # that will be written

    def _begin(self, path: Path, coding: Coding, depth_step_mm: float) -> None:
        check_folder_for(path)
        if path.exists():
            raise FileProblem("a file of this name exists; choose another name", path)
        super()._begin(path, coding, depth_step_mm)
        self._flushed_s = 0.0

    def _open_place(self, path: Path) -> BinaryIO:
        return self._place.enter_context(open_growing_file(path, "the recording"))

    def append(
        self,
        stream: str,
        frame: TactileFrame,
        truth: Truth | None = None,
        *,
        effort: Effort = "little",
    ) -> None:
        """Add one frame to a stream.

        Raises ShapeError where it differs in shape from the first.
        """
        super().append(stream, frame, truth, effort=effort)
        if not self._file.swmr_mode and len(self._file["streams"]) == self.n_streams:
            self._file.swmr_mode = True
        now_s = time.monotonic()
        if now_s - self._flushed_s > FLUSH_INTERVAL_S:
            self._flushed_s = now_s
            self._file.flush()

    def __exit__(
        self,
        _kind: type[BaseException] | None,
        error: BaseException | None,
        _at: TracebackType | None,
    ) -> None:
        """Close the file and keep all frames, also after an error; delete a file without frames."""
        with self._place:
            empty = self._file is None or not len(self._file.get("streams", ()))
            if self._file is not None:
                self._file.close()
                layout.truncate_to_size(self._temporary)
            if empty:
                self._path.unlink(missing_ok=True)
            if error is not None:
                raise error
            if not empty:
                read_back(self._path, self._path, "the recording", _read_last)


def _read_last(path: Path) -> None:
    """Read the last frame of a recording."""
    with closing(hdf5.read(path)) as recording:
        for stream in recording.streams:
            stream.frame(stream.n_frames - 1)


_QUEUE_FRAMES = 240  # some seconds of a fast sensor
_BEHIND_FRAMES = 30  # in the queue, from which on frames are not compressed
# stream, frame and truth; None ends the thread
_Item = tuple[str, TactileFrame, Truth | None] | None


class LiveRecorder:
    """Writes all frames that a reader reads from now on, until it is closed."""

    def __init__(self, path: Path, reader: LiveReader) -> None:
        """Begin a recording; raises FileProblem where nothing can be written."""
        self.path = path
        self._writer = LiveRecordingWriter(
            path, notes=(f"recorded live: {reader.title}",), coding="row differences"
        )
        self._writer.n_streams = len(reader.make_streams())
        self._reader = reader
        self._has_begun = False
        self._queue: queue.Queue[_Item] = queue.Queue(_QUEUE_FRAMES)
        self.n_written = self.n_dropped = 0
        self.problem = ""  # why writing has ended
        self._thread = threading.Thread(target=self._write_frames, name="recorder", daemon=True)
        self._thread.start()
        reader.set_listener(self._offer)

    def _offer(self, stream: str, frame: TactileFrame, truth: Truth | None) -> None:
        """Queue a frame that has a reference, the source's first; it is dropped if the queue is
        full.
        """
        if frame.reference is None:
            return
        if not self._has_begun:
            self._has_begun = stream == self._reader.stream_name and self._reader.has_reference
            if not self._has_begun:
                return
        try:
            self._queue.put_nowait((stream, frame, truth))
        except queue.Full:
            self.n_dropped += 1

    def close(self, timeout_s: float = 10.0) -> bool:
        """Write the queue and close the file; whether that was done in time."""
        self._reader.set_listener(None)
        self._queue.put(None)
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _write_frames(self) -> None:
        try:
            with self._writer as writer:
                while (item := self._queue.get()) is not None:
                    is_behind = self._queue.qsize() >= _BEHIND_FRAMES
                    writer.append(*item, effort="none" if is_behind else "little")
                    self.n_written += 1
        except (TouchError, OSError) as error:
            self.problem = str(error)
            while self._queue.get() is not None:
                self.n_dropped += 1
