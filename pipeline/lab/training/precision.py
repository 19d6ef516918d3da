"""Networks that compute in 16 bits while they are trained; their parameters stay float32."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torch import nn


def wrap_precision(network: nn.Module, precision: str) -> nn.Module:
    """The network computing in `precision` with float32 output; its parameters stay float32."""
    import torch
    from torch import nn
    from torch.utils._pytree import tree_map_only

    if precision == "float32":
        return network

    def widen(tensor: Any) -> Any:
        return tensor.float() if tensor.is_floating_point() else tensor

    class Bf16Wrapper(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.network = network

        def forward(self, *inputs: Any) -> Any:
            with torch.autocast(inputs[0].device.type, torch.bfloat16):
                return tree_map_only(torch.Tensor, widen, self.network(*inputs))

    return Bf16Wrapper()


def unwrap_network(network: Any) -> Any:
    """The network without the wrapper for precision."""
    return getattr(network, "network", network)
