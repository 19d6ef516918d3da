"""Examples that stay on the device that learns, for one that learns faster than processors make them.

They are made once, at the beginning of every part of a run, and drawn from at random; which ones a step is shown
depends on the seed and the step alone, so that a run that was stopped goes on as if it had not been.
"""

from __future__ import annotations

from collections.abc import Generator
from itertools import count, islice
from typing import TYPE_CHECKING, Any

from pipeline.training.distributed import ProcessGroup
from pipeline.training.examples import ExampleSource
from pipeline.training.recipe import TrainingSettings

if TYPE_CHECKING:
    from torch import Tensor

_FIELDS = 3  # axes from which on an array is a field, kept in 16 bits: its noise is coarser


def iterate_cached_batches(
    source: ExampleSource, pace: TrainingSettings, here: ProcessGroup, first: int
) -> Generator[dict[str, Tensor], None, None]:
    """Batches on the device for step `first` and all that follow, drawn from the first `pace.kept` examples.

    With several devices each keeps its own share of them.
    """
    import torch

    pool = _gathered(source, pace, here)
    n = len(next(iter(pool.values())))
    for step in count(first):
        chance = torch.Generator().manual_seed(_seed(pace.seed, step, here.rank))
        chosen = torch.randint(n, (pace.batch,), generator=chance).to(here.device)
        yield {name: _shown(tensor[chosen]) for name, tensor in pool.items()}


def _gathered(source: ExampleSource, pace: TrainingSettings, here: ProcessGroup) -> dict[str, Tensor]:
    import torch

    n_batches = -(-pace.n_cached_examples // (pace.batch * here.world_size))
    n, filled = n_batches * pace.batch, 0
    pool: dict[str, Tensor] = {}
    batches = source.iterate_batches(here.rank * pace.batch, pace.batch * here.world_size)
    try:
        for batch in islice(batches, n_batches):
            for name, array in batch.items():
                tensor = torch.from_numpy(array)
                if tensor.ndim > _FIELDS and tensor.is_floating_point():
                    tensor = tensor.half()
                if name not in pool:
                    pool[name] = torch.empty((n, *tensor.shape[1:]), dtype=tensor.dtype, device=here.device)
                pool[name][filled : filled + pace.batch] = tensor.to(here.device)
            filled += pace.batch
    finally:
        batches.close()
    return pool


def _shown(batch: Any) -> Any:
    """As `loop.tensors` shows it."""
    import torch

    if batch.dtype == torch.float16:
        batch = batch.float()
    return batch.contiguous(memory_format=torch.channels_last) if batch.ndim == _FIELDS + 1 else batch


def _seed(seed: int, step: int, rank: int) -> int:
    import numpy as np

    return int(np.random.SeedSequence([seed, step, rank, 1]).generate_state(1)[0])
