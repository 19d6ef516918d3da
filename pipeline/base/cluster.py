"""Work on other machines: Dask's workers behind a scheduler's address, as processes of this machine are used.

What is sent is a function of a module and plain values, so that a worker needs the project installed and the files at
the same paths. A worker that dies loses nothing: what it had not handed over is done by another one.
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
        """The same as an executor, for those who hand out work piece by piece."""
        return self._client.get_executor(pure=False)

    def map(self, work: Callable[[Any], R], pieces: Sequence[Any], progress: Progress = SILENT) -> list[R]:
        """What `work` makes of every piece, in their order; raises what it raises, NotConverged where workers die.

        Results are taken as they come: what is here is not done again, whatever becomes of its worker.
        """
        from distributed import KilledWorker, as_completed

        futures = self._client.map(work, pieces, pure=False)
        place = {future.key: index for index, future in enumerate(futures)}
        found: dict[int, R] = {}
        try:
            for future in as_completed(futures, loop=self._client.loop):
                found[place[future.key]] = future.result()
                future.release()  # else the scheduler has it done again when the worker that keeps it dies
                progress.step(len(found) / len(pieces), f"{len(found)} of {len(pieces)} done elsewhere")
        except KilledWorker as error:
            raise NotConverged(
                "several workers died over the same piece of work, perhaps for want of memory"
            ) from error
        finally:
            self._client.cancel(futures)
        return [found[index] for index in range(len(pieces))]


@contextmanager
def connect_cluster(address: str) -> Generator[ClusterPool, None, None]:
    """The workers of the scheduler at `address`, as `tcp://host:8786`; raises SettingProblem where there is none."""
    try:
        from distributed import Client
    except ImportError as error:
        raise SettingProblem("--scheduler needs Dask: install it with `pip install 'tactoscope[cluster]'`") from error
    logging.getLogger("distributed").setLevel(logging.ERROR)  # that a worker died is no news: its work goes on
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise SettingProblem(f"no scheduler answers at {address!r}; start one with `dask scheduler`") from error
    try:
        yield ClusterPool(client)
    finally:
        client.close()
