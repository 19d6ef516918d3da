"""Record a live sensor on a thread of its own, so that a slow disk delays nothing else."""

import queue
import threading
from pathlib import Path

from pipeline.base.errors import TouchError
from pipeline.recordings.hdf5_live_writer import LiveRecordingWriter
from pipeline.values.frames import TactileFrame, Truth

_QUEUE_FRAMES = 240  # some seconds of a fast sensor
_Item = tuple[TactileFrame, Truth | None] | None  # None ends the thread


class LiveRecorder:
    """Writes the frames that a reader offers; pass `offer` to `LiveReader.set_listener`."""

    def __init__(self, path: Path, about: str) -> None:
        """Begin a recording; raises FileProblem where nothing can be written."""
        self.path = path
        self._writer = LiveRecordingWriter(path, notes=(f"recorded live: {about}",), coding="row differences")
        self._queue: queue.Queue[_Item] = queue.Queue(_QUEUE_FRAMES)
        self.n_written = self.n_dropped = 0
        self.problem = ""  # why writing has ended
        self._thread = threading.Thread(target=self._write_frames, name="recorder", daemon=True)
        self._thread.start()

    def offer(self, frame: TactileFrame, truth: Truth | None) -> None:
        """Write a frame that has a reference; it is dropped if the queue is full."""
        if frame.reference is None:
            return
        try:
            self._queue.put_nowait((frame, truth))
        except queue.Full:
            self.n_dropped += 1

    def close(self, timeout_s: float = 10.0) -> bool:
        """Write the queue and close the file; whether that was done in time."""
        self._queue.put(None)
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _write_frames(self) -> None:
        try:
            with self._writer as writer:
                while (item := self._queue.get()) is not None:
                    frame, truth = item
                    writer.append(frame.sensor, frame, truth)
                    self.n_written += 1
        except (TouchError, OSError) as error:
            self.problem = str(error)
            while self._queue.get() is not None:
                self.n_dropped += 1
