"""Training in one process or several: `torchrun` starts one for each device, and their batches
are summed.
"""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from pipeline.core.frozen import frozen

if TYPE_CHECKING:
    import torch
    from torch import nn


@frozen
class ProcessGroup:
    """This process among those that train together."""

    rank: int
    world_size: int
    device: torch.device

    def wrap_distributed(self, network: nn.Module) -> nn.Module:
        """The network with gradients averaged over all processes."""
        if self.world_size == 1:
            return network
        from torch.nn.parallel import DistributedDataParallel

        return DistributedDataParallel(
            network, device_ids=[self.device] if self.device.type == "cuda" else None
        )

    def average_over_processes(self, *numbers: float) -> list[float]:
        """The mean of each number over all processes."""
        if self.world_size == 1:
            return list(numbers)
        import torch
        from torch import distributed

        sums = torch.tensor(numbers, dtype=torch.float64, device=self.device)
        distributed.all_reduce(sums)
        return (sums / self.world_size).tolist()


@contextmanager
def join_process_group() -> Generator[ProcessGroup, None, None]:
    """Join the processes that `torchrun` started, if any.

    The device is a GPU of its own or the processor.
    """
    import torch
    from torch import distributed

    n = int(os.environ.get("WORLD_SIZE", "1"))
    rank = int(os.environ.get("RANK", "0"))
    cuda = torch.cuda.is_available()
    device = (
        torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0")))
        if cuda
        else torch.device("cpu")
    )
    if n == 1:
        yield ProcessGroup(rank=0, world_size=1, device=device)
        return
    distributed.init_process_group("nccl" if cuda else "gloo")
    try:
        yield ProcessGroup(rank=rank, world_size=n, device=device)
    finally:
        distributed.destroy_process_group()


def wrap_precision(network: nn.Module, precision: str, device: torch.device) -> nn.Module:
    """The network computing in `precision` with float32 output; its parameters stay float32."""
    import torch
    from torch import nn

    if precision == "float32":
        return network

    class Bf16Wrapper(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.network = network

        def forward(self, *inputs: Any) -> Any:
            with torch.autocast(device.type, torch.bfloat16):
                return _to_float32(self.network(*inputs))

    return Bf16Wrapper()


def unwrap_network(network: Any) -> Any:
    """The network without the wrappers for precision and several processes."""
    while (
        inner := getattr(network, "module", None) or getattr(network, "network", None)
    ) is not None:
        network = inner
    return network


def _to_float32(output: Any) -> Any:
    """Floating-point tensors, however nested, as float32."""
    from torch.utils._pytree import tree_map

    def convert(value: Any) -> Any:
        return value.float() if getattr(value, "is_floating_point", bool)() else value

    return tree_map(convert, output)
