"""Build networks without random parameters, whose memory and time are wasted where weights
follow.
"""

from collections.abc import Callable
from typing import Any

from torch.overrides import TorchFunctionMode

_INITIALISERS = {"kaiming_uniform_", "uniform_", "zero_", "normal_"}


class WithoutInitialisation(TorchFunctionMode):
    """Within the block, on this thread, initialisers leave tensors as they are allocated."""

    def __torch_function__(
        self,
        func: Callable[..., Any],
        types: Any,
        args: tuple[Any, ...] = (),
        kwargs: dict[str, Any] | None = None,
    ) -> Any:
        """Skip initialisers, and call everything else."""
        named = kwargs or {}
        name = getattr(func, "__name__", "")
        if name not in _INITIALISERS:
            return func(*args, **named)
        tensor = args[0] if args else named["tensor"]
        if name == "normal_":  # `trunc_normal_` repeats it until all numbers are within its range
            tensor.detach().fill_(0.0)
        return tensor
