"""Batches of examples, made ahead by worker processes. Example k depends on seed and k alone."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Executor
from contextlib import closing, contextmanager
from functools import partial
from itertools import count, islice
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.core.params import check_range
from pipeline.core.processes import WorkerPool
from pipeline.lab.training.distributed import ProcessGroup
from pipeline.lab.training.recipe import TrainingSettings
from pipeline.lab.training.task import SPLITS, Split, Task
from pipeline.lab.workers import map_ahead

if TYPE_CHECKING:
    from torch import Tensor

    from pipeline.lab.training.task import Example

MAX_WORKERS = 64
_NICE = 5  # of the workers: training has priority
_BATCHES_AHEAD = 2  # for each worker
_N_AXES = 4  # of batches of images, which are held in 16 bits: their noise is coarser


class ExampleSource:
    """Training batches and validation examples of a task.

    `check` is called while they are made and may raise.
    """

    def __init__(
        self, task: Task, seed: int, batch: int, pool: Executor | None, ahead: int
    ) -> None:
        self._task = task
        self._make_batch = partial(make_batch, task, seed, n=batch)
        self._pool = pool
        self._ahead = ahead
        self.check: Callable[[], None] = lambda: None

    def iterate_batches(self, first: int, stride: int) -> Generator[Example, None, None]:
        """Endless batches that begin at example `first`, `first + stride` and so on."""
        return self._map(self._make_batch, count(first, stride))

    def make_validation_set(self, n: int) -> dict[Split, list[Example]]:
        """The first `n` validation examples of every split, or as many as there are.

        Without splits that have none.
        """
        made: dict[Split, list[Example]] = {
            split: list(
                self._map(
                    partial(self._task.make_validation_example, split),
                    range(min(n, self._task.count_validation_examples(split))),
                )
            )
            for split in SPLITS
        }
        return {split: examples for split, examples in made.items() if examples}

    def _map(
        self, function: Callable[[int], Any], numbers: Iterable[int]
    ) -> Generator[Any, None, None]:
        """Results in order; the pool makes some ahead."""
        remedy = "--resume and fewer --workers"
        return map_ahead(self._pool, function, numbers, self._ahead, remedy, self.check)


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


def make_batch(task: Task, seed: int, start: int, n: int) -> Example:
    """Examples `start` to `start + n` as one batch: name -> (n, ...)."""
    made = [task.sample(np.random.default_rng([seed, start + k])) for k in range(n)]
    return {name: np.stack([one[name] for one in made]) for name in made[0]}


def iterate_cached_batches(
    source: ExampleSource, settings: TrainingSettings, group: ProcessGroup, first: int
) -> Generator[dict[str, Tensor], None, None]:
    """Batches from step `first` on, sampled from the first `settings.n_cached_examples` examples,
    which are held on the device: for a GPU that trains faster than processors make examples.

    They are made once, at the start of every part of a run. Each of several processes holds its own
    share of them. The examples of a step depend on seed and step alone, so that a resumed run
    continues like an uninterrupted one.
    """
    import torch

    stride = settings.batch * group.world_size
    n_batches = -(-settings.n_cached_examples // stride)
    n = n_batches * settings.batch
    pool: dict[str, Tensor] = {}
    with closing(source.iterate_batches(group.rank * settings.batch, stride)) as batches:
        for k, batch in enumerate(islice(batches, n_batches)):
            for name, array in batch.items():
                tensor = torch.from_numpy(array)
                if tensor.ndim >= _N_AXES and tensor.is_floating_point():
                    tensor = tensor.half()
                if name not in pool:
                    pool[name] = torch.empty(
                        (n, *tensor.shape[1:]), dtype=tensor.dtype, device=group.device
                    )
                pool[name][k * settings.batch :][: settings.batch] = tensor.to(group.device)
    for step in count(first):
        seeds = np.random.SeedSequence([settings.seed, step, group.rank, 1])
        rng = torch.Generator().manual_seed(int(seeds.generate_state(1)[0]))
        indices = torch.randint(n, (settings.batch,), generator=rng).to(group.device)
        yield {
            name: to_channels_last(t[indices].float() if t.dtype == torch.float16 else t[indices])
            for name, t in pool.items()
        }


def to_tensors(batch: Example, device: Any) -> dict[str, Any]:
    """A batch of arrays as tensors on a device."""
    import torch

    return {
        name: to_channels_last(torch.from_numpy(array).to(device)) for name, array in batch.items()
    }


def to_channels_last(batch: Tensor) -> Tensor:
    """Batches of images in torch's channels-last memory format; others as they are."""
    import torch

    return batch.contiguous(memory_format=torch.channels_last) if batch.ndim == _N_AXES else batch
