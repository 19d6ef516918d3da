"""Work on other machines: Dask workers behind a scheduler's address, used like local processes.

A task is a module's function and plain values, so a worker needs the project installed and the
files at the same paths. If a worker dies, its unfinished tasks go to another one.
"""

import contextlib
import logging
import socket
import time
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from functools import partial
from queue import Empty, Queue
from typing import Any, TypeVar
from urllib.parse import urlsplit

from pipeline.core.errors import NotConverged, SettingProblem
from pipeline.core.progress import SILENT, Progress

R = TypeVar("R")
CONNECT_S = 10.0
NO_WORKER_S = 15.0  # without any worker, also at the start, until the work is given up
_MAX_GREETING_BYTES = 1 << 20  # of what a scheduler says first; it has some hundred
_POLL_S = 1.0  # between looks at the workers while nothing is finished


class ClusterPool:
    """The workers of a scheduler."""

    def __init__(self, client: Any) -> None:
        self._client = client

    @property
    def pool(self) -> Executor:
        """The workers as an executor, for single tasks."""
        return self._client.get_executor(pure=False)

    def map(
        self, work: Callable[[Any], R], pieces: Sequence[Any], progress: Progress = SILENT
    ) -> list[R]:
        """Return `work` of every piece, in order.

        Raises what it raises, NotConverged if no worker is left.

        Results are fetched as they come and never computed again. `progress` is called while
        nothing comes, too.
        """
        from distributed import KilledWorker

        futures = self._client.map(work, pieces, pure=False)
        done: Queue[int] = Queue()
        for index, future in enumerate(futures):
            future.add_done_callback(partial(_report_done, done, index))
        results: dict[int, R] = {}
        try:
            while len(results) < len(pieces):
                index = self._wait_for_result(done, progress, len(results), len(pieces))
                results[index] = futures[index].result()
                futures[index].release()  # otherwise it is computed again when its worker dies
                progress.step(
                    len(results) / len(pieces), _describe_count(len(results), len(pieces))
                )
        except KilledWorker as error:
            raise NotConverged(
                "several workers died over the same task, perhaps out of memory"
            ) from error
        finally:
            self._client.cancel(futures)
        return [results[index] for index in range(len(pieces))]

    def _wait_for_result(
        self, done: Queue[int], progress: Progress, n_done: int, n_pieces: int
    ) -> int:
        """Return the next index of `done`.

        Raises NotConverged after `NO_WORKER_S` without any worker.
        """
        last_seen_s = time.monotonic()
        while True:
            try:
                return done.get(timeout=_POLL_S)
            except Empty:
                progress.step(n_done / n_pieces, _describe_count(n_done, n_pieces))
            if self._count_workers():
                last_seen_s = time.monotonic()
            elif time.monotonic() - last_seen_s > NO_WORKER_S:
                raise NotConverged(
                    f"no worker of the scheduler was there for {NO_WORKER_S:g} s, {n_done} of "
                    f"{n_pieces} done; "
                    "start workers with `dask worker` and run again"
                )

    def _count_workers(self) -> int:
        """Return the number of workers that the scheduler knows; 0 if it does not answer."""
        try:
            return len(self._client.nthreads())
        except (OSError, TimeoutError):
            return 0


def _report_done(done: Queue[int], index: int, _future: object) -> None:
    done.put(index)


def _describe_count(n_done: int, n_pieces: int) -> str:
    return f"{n_done} of {n_pieces} done elsewhere"


def _require_scheduler(address: str) -> None:
    """Raise SettingProblem where no scheduler greets: the client of another server would try for
    minutes.

    Both sides begin with a message, whose first 8 bytes are its length.
    """
    greeting = b""
    with contextlib.suppress(OSError, ValueError):  # no such address, name or server
        parts = urlsplit(address if "://" in address else f"tcp://{address}")
        if parts.scheme == "tcp" and parts.hostname and parts.port:
            with socket.create_connection(
                (parts.hostname, parts.port), timeout=CONNECT_S
            ) as connection:
                greeting = connection.recv(8, socket.MSG_WAITALL)
    if len(greeting) < 8 or not 0 < int.from_bytes(greeting, "little") <= _MAX_GREETING_BYTES:
        raise SettingProblem(
            f"no scheduler answers at {address!r}; give an address such as "
            "tcp://192.168.0.2:8786, and start one there "
            "with `dask scheduler`"
        )


@contextmanager
def connect_cluster(address: str) -> Generator[ClusterPool, None, None]:
    """Connect to the scheduler at `address`, such as `tcp://host:8786`.

    Raises SettingProblem if there is none.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise SettingProblem(
            "--scheduler needs Dask: install it with `pip install 'tactoscope[cluster]'`"
        ) from error
    _require_scheduler(address)
    # a dead worker is no news: its work goes on
    logging.getLogger("distributed").setLevel(logging.ERROR)
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise SettingProblem(
            f"no scheduler answers at {address!r}; start one with `dask scheduler`"
        ) from error
    try:
        yield ClusterPool(client)
    finally:
        client.close()
