"""Work on other machines: Dask workers behind a scheduler's address, used like local processes.

A task is a module's function and plain values, so a worker needs the project installed and the files at the same paths.
If a worker dies, its unfinished tasks go to another one.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from typing import Any, TypeVar

from pipeline.base.errors import NotConverged, SettingProblem
from pipeline.base.progress import SILENT, Progress

R = TypeVar("R")
CONNECT_S = 10.0


class ClusterPool:
    """The workers of a scheduler."""

    def __init__(self, client: Any) -> None:
        self._client = client

    @property
    def pool(self) -> Executor:
        """The workers as an executor, for single tasks."""
        return self._client.get_executor(pure=False)

    def map(self, work: Callable[[Any], R], pieces: Sequence[Any], progress: Progress = SILENT) -> list[R]:
        """Return `work` of every piece, in order; raises what it raises, NotConverged if workers keep dying.

        Results are fetched as they come and never computed again.
        """
        from distributed import KilledWorker, as_completed

        futures = self._client.map(work, pieces, pure=False)
        index_by_key = {future.key: index for index, future in enumerate(futures)}
        results: dict[int, R] = {}
        try:
            for future in as_completed(futures, loop=self._client.loop):
                results[index_by_key[future.key]] = future.result()
                future.release()  # otherwise it is computed again when its worker dies
                progress.step(len(results) / len(pieces), f"{len(results)} of {len(pieces)} done elsewhere")
        except KilledWorker as error:
            raise NotConverged("several workers died over the same task, perhaps out of memory") from error
        finally:
            self._client.cancel(futures)
        return [results[index] for index in range(len(pieces))]


@contextmanager
def connect_cluster(address: str) -> Generator[ClusterPool, None, None]:
    """Connect to the scheduler at `address`, such as `tcp://host:8786`; raises SettingProblem if there is none."""
    try:
        from distributed import Client
    except ImportError as error:
        raise SettingProblem("--scheduler needs Dask: install it with `pip install 'tactoscope[cluster]'`") from error
    logging.getLogger("distributed").setLevel(logging.ERROR)  # a dead worker is no news: its work goes on
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise SettingProblem(f"no scheduler answers at {address!r}; start one with `dask scheduler`") from error
    try:
        yield ClusterPool(client)
    finally:
        client.close()
