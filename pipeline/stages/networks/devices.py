"""Where a network runs: the one place that chooses device and precision, and moves the weights.

Everything around a network stays on the processor in float32: sampling, noise and schedules are the
same bytes everywhere, and only calls of the network cross over. Networks that OpenCV answers in
milliseconds stay on the processor.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from pipeline.core.errors import SettingProblem

if TYPE_CHECKING:
    from collections.abc import Callable

    from torch import nn

AUTO = "auto"
PROCESSOR = "cpu float32"
_FORM = re.compile(r"auto|cpu|mps|cuda(:\d+)?")
_N_PUBLISHED = 20_000_000  # parameters from which on a card is worth the way there
_HALF = "bfloat16"  # of published sizes on a card; float16 overflows, and the processor is exact


def check_device(asked: str) -> None:
    """Raise SettingProblem for a device that is unknown or not there."""
    if not _FORM.fullmatch(str(asked)):
        raise SettingProblem(
            f"there is no device {asked!r}; choose another (--device): auto, cpu, cuda, cuda:1 (of "
            "several) or mps"
        )
    if asked not in (AUTO, "cpu") and asked not in (there := list_devices()):
        raise SettingProblem(
            f"there is no device {asked!r} on this machine; choose another (--device): "
            f"{', '.join(there)}"
        )


def choose_placement(asked: str, n_parameters: int, *, by_opencv: bool) -> str:
    """Return device and precision of a network, such as "cuda bfloat16".

    `auto` takes a card for networks of published size. It is part of the key of a result, as bytes
    differ.
    """
    is_large = n_parameters >= _N_PUBLISHED
    if by_opencv or asked == "cpu" or (asked == AUTO and not is_large):
        return PROCESSOR
    device = asked if asked != AUTO else list_devices()[-1]
    return f"{device} {_HALF}" if is_large and device != "cpu" else f"{device} float32"


def list_devices() -> tuple[str, ...]:
    """Return the devices of this machine: the processor, then cards."""
    import torch

    n_cards = torch.cuda.device_count() if torch.cuda.is_available() else 0
    cards = [f"cuda:{k}" for k in range(n_cards)] + ["cuda"] * (n_cards > 0)
    return ("cpu", *cards, *(["mps"] if torch.backends.mps.is_available() else []))


def place_network(net: nn.Module, placement: str) -> Any:
    """Return a network that computes where `placement` says, and is used like one here."""
    device, _, precision = placement.partition(" ")
    if placement == PROCESSOR:
        return net
    try:
        return _PlacedNetwork(net.to(device), device, precision)
    except RuntimeError as error:
        raise _explain(error, device) from error


class _PlacedNetwork:
    """A network on another device or in another precision: its calls and those of its parts take
    tensors of the processor and return such ones in float32.
    """

    def __init__(self, net: Any, device: str, precision: str) -> None:
        self._net = net
        self._device = device
        self._precision = precision

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._net, name)
        return self._cross(value) if callable(value) else value

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return self._cross(self._net)(*args, **kwargs)

    def _cross(self, call: Callable[..., Any]) -> Callable[..., Any]:
        import torch
        from torch.utils._pytree import tree_map_only

        def move(tensor: Any) -> Any:
            return tensor.to(self._device)

        def bring_back(tensor: Any) -> Any:
            here = tensor.cpu()
            return here.float() if here.is_floating_point() else here

        def compute(*args: Any, **kwargs: Any) -> Any:
            there, named = tree_map_only(torch.Tensor, move, (args, kwargs))
            uses_half = self._precision == _HALF
            try:
                with torch.autocast(
                    self._device.partition(":")[0], torch.bfloat16, enabled=uses_half
                ):
                    answer = call(*there, **named)
                return tree_map_only(torch.Tensor, bring_back, answer)
            except torch.OutOfMemoryError as error:
                raise _explain(error, self._device) from error

        return compute


def _explain(error: RuntimeError, device: str) -> SettingProblem:
    said = str(error).splitlines()[0]
    return SettingProblem(
        f"the network does not run on {device!r} ({said}); close what else uses its memory, or "
        "choose --device cpu"
    )
