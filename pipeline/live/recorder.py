"""Recording while watching: a thread of its own writes what the reader takes, so that a slow disk delays nobody."""

from __future__ import annotations

import queue
import threading
from pathlib import Path

from pipeline.base.errors import TouchError
from pipeline.recordings.hdf5_live_writer import LiveRecordingWriter
from pipeline.values.frames import TactileFrame, Truth

_MOST_WAITING = 240  # frames: some seconds of a fast sensor
_Item = tuple[TactileFrame, Truth | None] | None


class LiveRecorder:
    """Give `offer` to a reader's `listen`."""

    def __init__(self, path: Path, about: str) -> None:
        """Raises FileProblem where nothing can be written."""
        self.path = path
        self._writer = LiveRecordingWriter(path, notes=(f"recorded live: {about}",), coding="row differences")
        self._waiting: queue.Queue[_Item] = queue.Queue(_MOST_WAITING)
        self.n_written = self.n_dropped = 0
        self.problem = ""  # why nothing is written any more
        self._thread = threading.Thread(target=self._loop, name="recorder", daemon=True)
        self._thread.start()

    def offer(self, frame: TactileFrame, truth: Truth | None) -> None:
        """Write it soon, once zero is set; it is left out where the disk is that far behind."""
        if frame.reference is None:
            return
        try:
            self._waiting.put_nowait((frame, truth))
        except queue.Full:
            self.n_dropped += 1

    def close(self, timeout_s: float = 10.0) -> bool:
        """Write what waits and close the file; whether that was done in time."""
        self._waiting.put(None)
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _loop(self) -> None:
        try:
            with self._writer as writer:
                while (item := self._waiting.get()) is not None:
                    frame, truth = item
                    writer.append(frame.sensor, frame, truth)
                    self.n_written += 1
        except (TouchError, OSError) as error:
            self.problem = str(error)
            while self._waiting.get() is not None:
                self.n_dropped += 1
