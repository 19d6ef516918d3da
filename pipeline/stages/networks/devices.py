"""Where a network runs: the one place that chooses device and precision, and moves the weights.

Everything around a network stays on the processor in float32: sampling, noise and schedules are the
same bytes everywhere, and only calls of the network cross over. Networks that OpenCV answers in
milliseconds stay on the processor.
"""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, cast

from pipeline.core.errors import SettingProblem

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

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

        def compute(*args: Any, **kwargs: Any) -> Any:
            there = [_map_tensors(arg, lambda t: t.to(self._device)) for arg in args]
            named = {
                k: _map_tensors(arg, lambda t: t.to(self._device)) for k, arg in kwargs.items()
            }
            uses_half = self._precision == _HALF
            try:
                with torch.autocast(
                    self._device.partition(":")[0], torch.bfloat16, enabled=uses_half
                ):
                    answer = call(*there, **named)
                return _map_tensors(answer, _bring_back)
            except torch.OutOfMemoryError as error:
                raise _explain(error, self._device) from error

        return compute


def _bring_back(tensor: Any) -> Any:
    here = tensor.cpu()
    return here.float() if here.is_floating_point() else here


def _map_tensors(value: Any, change: Callable[[Any], Any]) -> Any:
    """Return a value with its tensors changed, also those in tuples and dataclasses."""
    import torch

    if isinstance(value, torch.Tensor):
        return change(value)
    if isinstance(value, tuple | list):
        parts = [_map_tensors(part, change) for part in cast("Iterable[Any]", value)]
        return type(value)(*parts) if hasattr(value, "_fields") else type(value)(parts)
    if is_dataclass(value) and not isinstance(value, type):
        named = {f.name: _map_tensors(getattr(value, f.name), change) for f in fields(value)}
        return replace(value, **named)
    return value


def _explain(error: RuntimeError, device: str) -> SettingProblem:
    said = str(error).splitlines()[0]
    return SettingProblem(
        f"the network does not run on {device!r} ({said}); close what else uses its memory, or "
        "choose --device cpu"
    )
