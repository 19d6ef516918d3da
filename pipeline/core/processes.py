"""Worker processes of one thread each, which ignore Ctrl-C and end with their parent."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
import threading
import time
from concurrent.futures import Future, ProcessPoolExecutor
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multiprocessing.connection import Connection


_POLL_S = 0.01


class WorkerPool(ProcessPoolExecutor):
    """`n` workers, started with the first task; `nice` lowers their priority.

    As a context it waits for its tasks, or ends its workers at once where an error or a request to
    stop leaves it.
    """

    def __init__(self, n: int, nice: int = 0) -> None:
        """Start nothing yet."""
        import multiprocessing

        import cv2

        del cv2
        # Workers take over the module path, which OpenCV changes while another thread imports it.
        while hasattr(sys, "OpenCV_LOADER"):
            time.sleep(_POLL_S)
        context = multiprocessing.get_context("spawn")
        watched, self._lifeline = context.Pipe(duplex=False)
        super().__init__(n, mp_context=context, initializer=_initialise, initargs=(nice, watched))

    def submit(self, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a task; a worker that starts for it inherits that Ctrl-C is blocked, even while
        it imports.
        """
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
        try:
            return super().submit(*args, **kwargs)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Wait for the tasks; after an error drop them."""
        results: Any = self._result_queue
        manager: Any = self._executor_manager_thread
        self.shutdown(wait=kind is None, cancel_futures=kind is not None)
        if kind is not None:
            self._lifeline.close()  # the workers end, whatever they are doing
            # or who reads what one of them was writing would wait for the rest of it
            results._writer.close()
            if manager is not None:
                manager.join()


def _initialise(nice: int, lifeline: Connection) -> None:
    if hasattr(os, "setpgrp"):
        os.setpgrp()  # signals to the group are for the parent
    threading.Thread(target=_end_with_parent, args=(lifeline,), daemon=True).start()
    if nice and hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(nice)
    limit_threads()


def limit_threads() -> None:
    """Let the libraries of this process compute on one thread each, so that sums do not depend
    on the machine.
    """
    os.environ["OMP_NUM_THREADS"] = "1"  # read by torch when it is imported
    import cv2

    cv2.setNumThreads(1)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


def _end_with_parent(lifeline: Connection) -> None:
    """End this worker when its parent is killed, for which it would wait forever, or closes its
    end of the pipe.
    """
    import multiprocessing
    from multiprocessing.connection import wait

    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel, lifeline])
        os._exit(1)


_ARENA_MAX = -8  # glibc's M_ARENA_MAX
_MAX_ARENAS = 2


def limit_arenas() -> bool:
    """Limit threads to two shared heaps, as each keeps its peak.

    Returns whether that was possible.
    """
    library = _glibc()
    return library is not None and bool(library.mallopt(_ARENA_MAX, _MAX_ARENAS))


def release_free_memory() -> None:
    """Return free memory to the system, with glibc.

    After closing a recording a hundred megabytes may be fragmented.
    """
    library = _glibc()
    if library is not None:
        library.malloc_trim(0)


def _glibc() -> ctypes.CDLL | None:
    if not sys.platform.startswith("linux"):
        return None
    library = ctypes.CDLL(None)
    return library if hasattr(library, "malloc_trim") and hasattr(library, "mallopt") else None
