"""Worker processes of one thread each, which ignore Ctrl-C and end with their parent."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from concurrent.futures import ProcessPoolExecutor


def worker_pool(n: int, nice: int = 0) -> ProcessPoolExecutor:
    """Return a pool of `n` workers, started with the first task; `nice` lowers their priority."""
    import multiprocessing

    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(n, mp_context=context, initializer=_initialise, initargs=(nice,))


def _initialise(nice: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "setpgrp"):
        os.setpgrp()  # signals to the group are for the parent
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if nice and hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(nice)
    limit_threads()


def limit_threads() -> None:
    """Let the libraries of this process compute on one thread each, so that sums do not depend on the machine."""
    os.environ["OMP_NUM_THREADS"] = "1"  # read by torch when it is imported
    import cv2

    cv2.setNumThreads(1)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


def _end_with_parent() -> None:
    """End this worker when its parent is killed; it would wait forever."""
    import multiprocessing
    from multiprocessing.connection import wait

    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
