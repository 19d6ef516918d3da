"""Worker processes: fresh ones of one thread each, that leave Ctrl-C to their parent and end with it."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from concurrent.futures import ProcessPoolExecutor


def worker_pool(n: int, nice: int = 0) -> ProcessPoolExecutor:
    """`n` workers, started with the first work; `nice` is how far they stand back behind other processes."""
    import multiprocessing

    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(n, mp_context=context, initializer=_begin, initargs=(nice,))


def _begin(nice: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "setpgrp"):
        os.setpgrp()  # what asks the whole group to end is for the parent to answer
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if nice and hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(nice)
    os.environ["OMP_NUM_THREADS"] = "1"
    import cv2
    import numba

    cv2.setNumThreads(1)
    numba.set_num_threads(1)


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for its next work forever."""
    import multiprocessing
    from multiprocessing.connection import wait

    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
