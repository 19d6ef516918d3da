"""Examples held on the training device, for a GPU that trains faster than processors make examples.

They are made once, at the start of every part of a run, and sampled at random. The examples of a
step depend on seed and step alone, so that a resumed run continues like an uninterrupted one.
"""

from __future__ import annotations

from collections.abc import Generator
from itertools import count, islice
from typing import TYPE_CHECKING

import numpy as np

from pipeline.lab.training.distributed import ProcessGroup
from pipeline.lab.training.examples import ExampleSource
from pipeline.lab.training.recipe import TrainingSettings

if TYPE_CHECKING:
    from torch import Tensor

_N_AXES = 4  # of batches of images, which are held in 16 bits: their noise is coarser


def iterate_cached_batches(
    source: ExampleSource, settings: TrainingSettings, group: ProcessGroup, first: int
) -> Generator[dict[str, Tensor], None, None]:
    """Batches on the device from step `first` on, sampled from the first
    `settings.n_cached_examples` examples.

    Each of several processes holds its own share of them.
    """
    import torch

    pool = _make_pool(source, settings, group)
    n = len(next(iter(pool.values())))
    for step in count(first):
        seeds = np.random.SeedSequence([settings.seed, step, group.rank, 1])
        rng = torch.Generator().manual_seed(int(seeds.generate_state(1)[0]))
        indices = torch.randint(n, (settings.batch,), generator=rng).to(group.device)
        batch = {name: tensor[indices] for name, tensor in pool.items()}
        yield {
            name: to_channels_last(t.float() if t.dtype == torch.float16 else t)
            for name, t in batch.items()
        }


def _make_pool(
    source: ExampleSource, settings: TrainingSettings, group: ProcessGroup
) -> dict[str, Tensor]:
    import torch

    n_batches = -(-settings.n_cached_examples // (settings.batch * group.world_size))
    n = n_batches * settings.batch
    filled = 0
    pool: dict[str, Tensor] = {}
    batches = source.iterate_batches(group.rank * settings.batch, settings.batch * group.world_size)
    try:
        for batch in islice(batches, n_batches):
            for name, array in batch.items():
                tensor = torch.from_numpy(array)
                if tensor.ndim >= _N_AXES and tensor.is_floating_point():
                    tensor = tensor.half()
                if name not in pool:
                    pool[name] = torch.empty(
                        (n, *tensor.shape[1:]), dtype=tensor.dtype, device=group.device
                    )
                pool[name][filled : filled + settings.batch] = tensor.to(group.device)
            filled += settings.batch
    finally:
        batches.close()
    return pool


def to_channels_last(batch: Tensor) -> Tensor:
    """Batches of images in torch's channels-last memory format; others as they are."""
    import torch

    return batch.contiguous(memory_format=torch.channels_last) if batch.ndim == _N_AXES else batch
