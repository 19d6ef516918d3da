"""Builds networks from weights. A network is one module of this package and one line of
`NETWORK_CLASSES`.

Fallback of methods by network: another method computes the value where weights are missing,
with the reason.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import inspect
import warnings
from collections.abc import Callable, Container, Generator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar, TypeVarTuple, Unpack

import numpy as np
from numpy.typing import NDArray

from pipeline.core import disk_store
from pipeline.core.arrays import Floats
from pipeline.core.entry_points import load_reference
from pipeline.core.errors import ModelMissing
from pipeline.core.graph import EarlyAnswer, Fallback, Method, Skipped
from pipeline.core.memo import Memo
from pipeline.core.params import Value
from pipeline.core.progress import Progress
from pipeline.stages.networks.devices import PROCESSOR, place_network
from pipeline.stages.networks.onnx_predictor import FirstPassPredictor, OnnxPredictor, export_onnx
from pipeline.stages.networks.weights import NoWeights, Weights

if TYPE_CHECKING:
    from torch import nn


NETWORK_CLASSES: dict[str, str] = {  # kind -> module:class; importing a module loads torch
    "compact_unet": "pipeline.stages.networks.compact_unet:CompactUnet",
    "depth_anything": "pipeline.stages.networks.depth_anything:DepthAnything",
    "residual_denoiser": "pipeline.stages.networks.residual_denoiser:ResidualDenoiser",
    "latent": "pipeline.stages.networks.latent_diffusion:LatentDiffusion",
    "unet": "pipeline.stages.networks.unet:UNet",
    "touch_policy": "pipeline.stages.networks.touch_policy:TouchPolicy",
    "touch_pose": "pipeline.stages.networks.touch_pose:TouchPose",
    "vqvae": "pipeline.stages.networks.vqvae:VqVae",
}
# answered by OpenCV, without torch
ONNX_KINDS = frozenset({"compact_unet", "residual_denoiser", "touch_policy"})
_MAX_BYTES = 2 << 30  # of cached networks; the largest takes 1.3 GB
_MOST_COUNT = 1024  # of channels, levels, steps or pixels that a small network may state
_loaded_networks: Memo[str, nn.Module] = Memo(
    4,
    most_bytes=_MAX_BYTES,
    weigh=lambda net: sum(p.numel() * p.element_size() for p in net.parameters()),
)
_RESIDUAL = "residual_denoiser"
_INITIALISERS = {"kaiming_uniform_", "uniform_", "zero_", "normal_"}
_predictors: Memo[str, OnnxPredictor | FirstPassPredictor] = Memo(4)


def build_network(kind: str, config: Mapping[str, Value]) -> nn.Module:
    """A network of this kind with random parameters.

    Raises ModelMissing for an unknown kind or wrong arguments.
    """
    if kind not in NETWORK_CLASSES:
        raise ModelMissing(f"unknown network {kind!r}; known are {', '.join(NETWORK_CLASSES)}")
    network_class: Any = load_reference(NETWORK_CLASSES[kind])
    unknown = sorted(config.keys() - inspect.signature(network_class).parameters.keys())
    if unknown:
        raise ModelMissing(
            f"these weights have settings that a {kind!r} lacks ({', '.join(unknown)}): another "
            "version of the program "
            "wrote them; export or train them again"
        )
    try:
        return network_class(**config)
    except (TypeError, ValueError, LookupError, ArithmeticError, RuntimeError) as error:
        raise ModelMissing(f"cannot build network {kind!r}: {error}") from error


def load_network(weights: Weights | NoWeights) -> nn.Module:
    """The network of these weights in eval mode, without gradients, where their placement says.

    It is cached; do not modify it. Raises ModelMissing where there are no weights or they do not
    fit their network.
    """
    if isinstance(weights, NoWeights):
        raise ModelMissing(weights.why)
    placement = weights.placement
    key = weights.content_digest + (f" {placement}" if placement != PROCESSOR else "")
    return _loaded_networks.get_or_make(
        key, lambda: place_network(_build_with_weights(weights), placement)
    )


def load_predictor(weights: Weights | NoWeights) -> Any:
    """A predictor for these weights: an `OnnxPredictor` for `ONNX_KINDS`, else `load_network`.

    Raises ModelMissing as `load_network` does. Weights without an ONNX file are exported first,
    which loads torch; a residual denoiser, whose ONNX file is that of its first pass, is then
    `load_network`.
    """
    if isinstance(weights, NoWeights) or weights.kind not in ONNX_KINDS:
        return load_network(weights)
    if weights.kind == _RESIDUAL and not weights.onnx:
        return load_network(weights)
    return _predictors.get_or_make(weights.content_digest, lambda: _load_predictor(weights))


def release_networks(keep: Container[str] = ()) -> None:
    """Drop cached networks except those whose weights have one of these digests."""
    _loaded_networks.keep_only(keep)
    _predictors.keep_only(keep)


def export_weights(weights: Weights) -> bytes:
    """An ONNX file of weights of `ONNX_KINDS`.

    Raises ModelMissing where they do not fit their network.
    """
    network: Any = load_network(weights)
    if weights.kind == _RESIDUAL:
        network = network.make_first_pass()
    return export_onnx(network, int(weights.config["inputs"]))


def _load_predictor(weights: Weights) -> OnnxPredictor | FirstPassPredictor:
    try:
        if weights.kind == _RESIDUAL:
            return FirstPassPredictor(weights, load_network)
        return OnnxPredictor(
            weights.read_onnx() or _export_once(weights), fold=int(weights.config.get("fold", 2))
        )
    except ValueError as error:
        raise ModelMissing(f"the weights {weights.name!r} cannot be run: {error}") from error


@dataclass(frozen=True, slots=True)
class _ExportedNetwork:
    content: NDArray[np.uint8]  # of its ONNX file


def _export_once(weights: Weights) -> bytes:
    """An ONNX file of weights that come without one, made once and kept in the user's cache:
    torch takes seconds.
    """
    made_of = weights.content_digest, importlib.metadata.version("torch")
    code = (
        "pipeline.stages.networks.onnx_predictor",
        *(path.partition(":")[0] for path in NETWORK_CLASSES.values()),
    )

    def export() -> _ExportedNetwork:
        return _ExportedNetwork(np.frombuffer(export_weights(weights), np.uint8))

    exported = disk_store.load_or_make(_ExportedNetwork, made_of, code, export, "onnx")
    return exported.content.tobytes()


def use_channels_last(net: nn.Module) -> nn.Module:
    """The same network with channels-last filters, whose steps take 3/4 of the time."""
    import torch

    convert: Any = net.to  # this overload is missing from torch's types
    return convert(memory_format=torch.channels_last)


def _skip_initialisation() -> contextlib.AbstractContextManager[Any]:
    """Within the block, on this thread, initialisers leave tensors as they are allocated: random
    parameters waste memory and time where weights follow.
    """
    from torch.overrides import TorchFunctionMode

    class WithoutInitialisation(TorchFunctionMode):
        def __torch_function__(
            self, func: Any, types: Any, args: Any = (), kwargs: Any = None
        ) -> Any:
            name = getattr(func, "__name__", "")
            if name not in _INITIALISERS:
                return func(*args, **(kwargs or {}))
            tensor = args[0] if args else kwargs["tensor"]
            if name == "normal_":  # `trunc_normal_` repeats it until all are within its range
                tensor.detach().fill_(0.0)
            return tensor

    return WithoutInitialisation()


def _build_with_weights(weights: Weights) -> nn.Module:
    tensors = dict(weights.tensors)
    shapes = [side for tensor in tensors.values() for side in tensor.shape]
    most = max(_MOST_COUNT, len(tensors), *shapes)
    if any(
        abs(value) > most for value in weights.config.values() if isinstance(value, (int, float))
    ):
        raise ModelMissing(
            f"the weights {weights.name!r} state a network that their tensors cannot fill"
        )
    with _skip_initialisation():
        net = build_network(weights.kind, weights.config)
    expected = {name: tuple(tensor.shape) for name, tensor in net.state_dict().items()}
    found = {name: tensor.shape for name, tensor in tensors.items()}
    mismatched = {name for name, _ in expected.items() ^ found.items()}
    if mismatched:
        examples = ", ".join(repr(name) for name in sorted(mismatched)[:2])
        raise ModelMissing(
            f"the weights {weights.name!r} do not fit the network {weights.kind!r}: "
            f"{len(mismatched)} tensors are "
            f"missing, unexpected or of another shape, such as {examples}"
        )
    _share_tensors(net, tensors)
    return use_channels_last(net).eval().requires_grad_(requires_grad=False)


def initialise_from(net: nn.Module, weights: Weights) -> int:
    """Copy the tensors that match the network by name and shape; returns their number.

    A layer of more inputs ignores the last of them at first. Raises ModelMissing where none
    matches.
    """
    import torch

    expected: dict[str, Any] = net.state_dict()
    matching: dict[str, Any] = {}
    for name, tensor in weights.tensors.items():
        if name not in expected:
            continue
        copied = np.array(tensor)
        wanted = tuple(expected[name].shape)
        if len(wanted) == copied.ndim == 4 and wanted[1] > copied.shape[1]:
            copied = np.pad(copied, [(0, 0), (0, wanted[1] - copied.shape[1]), (0, 0), (0, 0)])
        if copied.shape == wanted:
            matching[name] = torch.from_numpy(copied)
    if not matching:
        raise ModelMissing(
            f"the weights {weights.name!r} share no tensor with this network; choose other "
            "initial weights"
        )
    net.load_state_dict(matching, strict=False)
    return len(matching)


def _share_tensors(net: nn.Module, tensors: Mapping[str, Floats]) -> None:
    """Make frozen arrays a network's tensors, without a copy where they have its type and order."""
    import torch

    shared: dict[str, Any] = {}
    for name, tensor in net.state_dict().items():
        with warnings.catch_warnings():
            # "not writable": nothing writes to a loaded network
            warnings.simplefilter("ignore", UserWarning)
            shared[name] = torch.from_numpy(tensors[name]).to(tensor.dtype)
    net.load_state_dict(shared, assign=True)


@contextlib.contextmanager
def reproducible_inference(n_threads: int = 1) -> Generator[None, None, None]:
    """Run torch without gradients on `n_threads`, whose number changes the last digits of sums.

    On a busy machine one thread is also the fastest: threads wait for each other at every layer.
    """
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(n_threads)
    try:
        with torch.inference_mode():
            yield
    finally:
        torch.set_num_threads(before)


Params = TypeVar("Params")
Output = TypeVar("Output")
Reads = TypeVarTuple("Reads")


def fall_back_without_weights(
    run: Callable[
        [Unpack[Reads], Any, Params, Progress], Output | Skipped[Output] | Fallback[Output]
    ],
    fallback: Method[Any, Output, *Reads],
    reason: str = "physics: no network for this pair",
) -> Callable[
    [Unpack[Reads], Weights | NoWeights, Params, Progress],
    Output | Skipped[Output] | Fallback[Output],
]:
    """Wrap `run` (*reads, network, params, progress) as a method's function whose last input is
    weights.

    Where the weights are missing or do not fit, `fallback`, which has the same inputs without
    weights, computes the value, and the result states `reason` and what is missing. Parameters of
    another class are replaced by the defaults of `fallback`.
    """

    def run_or_fall_back(
        *args: *tuple[*Reads, Weights | NoWeights, Params, Progress],
    ) -> Output | Skipped[Output] | Fallback[Output]:
        *_, weights, params, progress = args
        reads = args[:-3]
        try:
            network = load_predictor(weights)
        except ModelMissing as problem:
            fallback_params = params if isinstance(params, fallback.params) else fallback.params()
            answer = fallback.run(*reads, fallback_params, progress)
            answer = answer.result if isinstance(answer, Fallback) else answer
            answer = answer.output if isinstance(answer, EarlyAnswer) else answer
            return Fallback(result=answer, reason=f"{reason}; {problem}")
        return run(*reads, network, params, progress)

    return run_or_fall_back
