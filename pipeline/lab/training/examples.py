"""Batches of examples, made ahead by worker processes. Example k depends on seed and k alone."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.core.errors import NotConverged
from pipeline.core.params import check_range
from pipeline.core.processes import WorkerPool
from pipeline.lab.training.task import SPLITS, HasFewExamples, Split, Task

if TYPE_CHECKING:
    from pipeline.lab.training.task import Example

MAX_WORKERS = 64
_NICE = 5  # of the workers: training has priority
_BATCHES_AHEAD = 2  # for each worker
_CHUNK = 4  # validation examples that a worker makes in one call
_CHECK_S = 0.5  # between two looks for a request to stop


class ExampleSource:
    """Training batches and validation examples of a task.

    `check` is called while they are made and may raise.
    """

    def __init__(
        self, task: Task, seed: int, batch: int, pool: Executor | None, ahead: int
    ) -> None:
        self._task = task
        self._seed = seed
        self._batch = batch
        self._pool = pool
        self._ahead = ahead
        self.check: Callable[[], None] = lambda: None

    def iterate_batches(self, first: int, stride: int) -> Generator[Example, None, None]:
        """Endless batches that begin at example `first`, `first + stride` and so on."""
        waiting: deque[Future[Example]] = deque()
        try:
            while True:
                if self._pool is None:
                    yield make_batch(self._task, self._seed, first, self._batch, self.check)
                else:
                    while len(waiting) < self._ahead:
                        start = first + len(waiting) * stride
                        waiting.append(
                            self._pool.submit(
                                make_batch, self._task, self._seed, start, self._batch
                            )
                        )
                    yield self._get_result(waiting.popleft())
                first += stride
        finally:
            for future in waiting:
                future.cancel()

    def make_validation_set(self, n: int) -> dict[Split, list[Example]]:
        """The first `n` validation examples of every split, or as many as there are.

        Without splits that have none.
        """
        made: dict[Split, list[Example]] = {}
        for split in SPLITS:
            count = (
                min(n, self._task.count_validation_examples(split))
                if isinstance(self._task, HasFewExamples)
                else n
            )
            if not count:
                continue
            parts = [range(start, min(start + _CHUNK, count)) for start in range(0, count, _CHUNK)]
            if self._pool is None:
                made[split] = []
                for part in parts:
                    self.check()
                    made[split] += make_validation_examples(self._task, split, part)
            else:
                futures = [
                    self._pool.submit(make_validation_examples, self._task, split, part)
                    for part in parts
                ]
                made[split] = [
                    example for future in futures for example in self._get_result(future)
                ]
        return made

    def _get_result(self, future: Future[Any]) -> Any:
        try:
            while not wait((future,), timeout=_CHECK_S).done:
                self.check()
            return future.result()
        except BrokenProcessPool as error:
            raise NotConverged(
                "a worker process died, perhaps out of memory; run again with --resume and fewer "
                "--workers"
            ) from error


@contextmanager
def open_example_source(
    task: Task, seed: int, batch: int, workers: int
) -> Generator[ExampleSource, None, None]:
    """Examples made by `workers` processes, in this process for 0; raises SettingProblem."""
    check_range("--workers", workers, 0, MAX_WORKERS)
    if not workers:
        yield ExampleSource(task, seed, batch, None, 0)
        return
    with WorkerPool(workers, _NICE) as pool:
        yield ExampleSource(task, seed, batch, pool, _BATCHES_AHEAD * workers)
        pool.shutdown(wait=False, cancel_futures=True)  # batches ahead that nobody asks for


def make_batch(
    task: Task, seed: int, start: int, n: int, check: Callable[[], None] | None = None
) -> Example:
    """Examples `start` to `start + n` as one batch: name -> (n, ...).

    `check` is called before each, and may raise.
    """
    made: list[Example] = []
    for index in range(start, start + n):
        if check is not None:
            check()
        made.append(task.sample(np.random.default_rng([seed, index])))
    return {name: np.stack([one[name] for one in made]) for name in made[0]}


def make_validation_examples(task: Task, split: Split, indices: Sequence[int]) -> list[Example]:
    """Validation examples by index."""
    return [task.make_validation_example(split, index) for index in indices]
