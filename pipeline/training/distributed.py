"""One device or several: `torchrun` starts a process for each, and they learn as one with the sum of their batches."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import torch
    from torch import nn


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessGroup:
    """This process among those that learn together."""

    rank: int
    world_size: int
    device: torch.device

    def wrap_distributed(self, network: nn.Module) -> nn.Module:
        """A network whose gradients are the mean over all processes."""
        if self.world_size == 1:
            return network
        from torch.nn.parallel import DistributedDataParallel

        return DistributedDataParallel(network, device_ids=[self.device] if self.device.type == "cuda" else None)

    def average_over_processes(self, *numbers: float) -> list[float]:
        """The mean of each number over all processes: the same in all of them."""
        if self.world_size == 1:
            return list(numbers)
        import torch
        from torch import distributed

        together = torch.tensor(numbers, dtype=torch.float64, device=self.device)
        distributed.all_reduce(together)
        return (together / self.world_size).tolist()


@contextmanager
def join_process_group() -> Generator[ProcessGroup, None, None]:
    """This process's device: the processor, or the CUDA card that is its own, alone or as `torchrun` says."""
    import torch
    from torch import distributed

    n, rank = int(os.environ.get("WORLD_SIZE", "1")), int(os.environ.get("RANK", "0"))
    cuda = torch.cuda.is_available()
    device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0"))) if cuda else torch.device("cpu")
    if n == 1:
        yield ProcessGroup(rank=0, world_size=1, device=device)
        return
    distributed.init_process_group("nccl" if cuda else "gloo")
    try:
        yield ProcessGroup(rank=rank, world_size=n, device=device)
    finally:
        distributed.destroy_process_group()


def wrap_precision(network: nn.Module, precision: str, device: torch.device) -> nn.Module:
    """A network that computes in that precision and answers in float32; its numbers stay float32."""
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
                return _wide(self.network(*inputs))

    return Bf16Wrapper()


def unwrap_network(network: Any) -> Any:
    """The network itself, inside what computes in a precision or on several devices."""
    while (inner := getattr(network, "module", None) or getattr(network, "network", None)) is not None:
        network = inner
    return network


def _wide(answer: Any) -> Any:
    """Tensors of floating point, however nested, as float32."""
    if isinstance(answer, dict):
        return {key: _wide(value) for key, value in answer.items()}
    if isinstance(answer, (tuple, list)):
        return (
            type(answer)(*(_wide(v) for v in answer))
            if hasattr(answer, "_fields")
            else type(answer)(map(_wide, answer))
        )
    return answer.float() if hasattr(answer, "is_floating_point") and answer.is_floating_point() else answer
