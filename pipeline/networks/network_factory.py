"""From weights to a network that is ready to use. A network is one module of this room and one line of `KINDS`."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Container, Mapping
from typing import TYPE_CHECKING, Any

from pipeline.base.errors import ModelMissing
from pipeline.base.memo import Memo
from pipeline.base.params import Value
from pipeline.networks.onnx_predictor import OnnxPredictor
from pipeline.networks.weights import NoWeights, Weights

if TYPE_CHECKING:
    from torch import nn

NETWORK_CLASSES: dict[str, str] = {  # kind -> module:class; torch loads with the module
    "compact_unet": "pipeline.networks.compact_unet:CompactUnet",
    "depth_anything": "pipeline.networks.depth_anything:DepthAnything",
    "residual_denoiser": "pipeline.networks.residual_denoiser:ResidualDenoiser",
    "gel_depth": "pipeline.networks.gel_depth:GelDepthNetwork",
    "latent": "pipeline.networks.latent_diffusion:LatentDiffusion",
    "touch_pose": "pipeline.networks.touch_pose:TouchPose",
    "vqvae": "pipeline.networks.vqvae:VqVae",
}
ONNX_KINDS = frozenset({"compact_unet", "gel_depth"})  # answered by OpenCV, without torch
_MOST_BYTES = 2 << 30  # of networks kept ready: a large one takes 1.3 GB
_loaded_networks: Memo[str, nn.Module] = Memo(
    4, most_bytes=_MOST_BYTES, weigh=lambda net: sum(p.numel() * p.element_size() for p in net.parameters())
)
_predictors: Memo[str, OnnxPredictor] = Memo(4)


def build_network(kind: str, config: Mapping[str, Value]) -> nn.Module:
    """A network of that kind with random numbers; raises ModelMissing for an unknown kind or wrong arguments."""
    if kind not in NETWORK_CLASSES:
        raise ModelMissing(f"no network {kind!r} in this version; there are {', '.join(NETWORK_CLASSES)}")
    module, _, name = NETWORK_CLASSES[kind].partition(":")
    try:
        return getattr(importlib.import_module(module), name)(**config)
    except (TypeError, ValueError) as error:
        raise ModelMissing(f"the network {kind!r} cannot be built so ({error})") from error


def load_network(weights: Weights | NoWeights) -> nn.Module:
    """The network of these weights, ready to answer: in eval mode, float32, on the processor, without gradients.

    Kept for the next call; not to be changed. Raises ModelMissing in one sentence where there are no weights, or where
    they do not fit the network that they name.
    """
    if isinstance(weights, NoWeights):
        raise ModelMissing(weights.why)
    return _loaded_networks.get_or_make(weights.content_digest, lambda: _loaded(weights))


def load_predictor(weights: Weights | NoWeights) -> Callable[..., Any]:
    """The network of these weights ready to predict: an `OnnxPredictor` for `ONNX_KINDS`, else `load_network`.

    Raises ModelMissing likewise. Weights without an ONNX file are exported first, which loads torch.
    """
    if isinstance(weights, NoWeights) or weights.kind not in ONNX_KINDS:
        return load_network(weights)
    return _predictors.get_or_make(weights.content_digest, lambda: _load_predictor(weights))


def release_networks(keep: Container[str] = ()) -> None:
    """Keep no network ready but those of weights with these contents; another is built when it is asked for."""
    _loaded_networks.keep_only(keep)
    _predictors.keep_only(keep)


def _load_predictor(weights: Weights) -> OnnxPredictor:
    from pipeline.networks.onnx_export import export_onnx

    try:
        return OnnxPredictor(weights.onnx or export_onnx(weights), fold=int(weights.config.get("fold", 2)))
    except ValueError as error:
        raise ModelMissing(f"the weights {weights.name!r} cannot be run: {error}") from error


def use_channels_last(net: nn.Module) -> nn.Module:
    """The same network with the channels of its filters innermost: a step takes three quarters of the time."""
    import torch

    convert: Any = net.to  # a form of it that torch's types leave out
    return convert(memory_format=torch.channels_last)


def _loaded(weights: Weights) -> nn.Module:
    made = build_network(weights.kind, weights.config)
    own: dict[str, Any] = made.state_dict()
    wrong = own.keys() ^ weights.tensors.keys()
    wrong |= {name for name, tensor in own.items() if name not in wrong and tensor.shape != weights.tensors[name].shape}
    if wrong:
        some = ", ".join(repr(name) for name in sorted(wrong)[:2])
        raise ModelMissing(
            f"the weights {weights.name!r} do not fit the network {weights.kind!r}: {len(wrong)} tensors are missing, "
            f"too many or of another shape, such as {some}"
        )
    copy_tensors(made, weights.tensors)
    return use_channels_last(made).eval().requires_grad_(requires_grad=False)


def initialise_from(net: nn.Module, weights: Weights) -> int:
    """Copy those tensors that have their like in the network, by name and shape, and say how many they are.

    Raises ModelMissing where there is none.
    """
    own: dict[str, Any] = net.state_dict()
    alike = [name for name, tensor in weights.tensors.items() if name in own and own[name].shape == tensor.shape]
    if not alike:
        raise ModelMissing(f"the weights {weights.name!r} have nothing in common with this network; begin with others")
    copy_tensors(net, {name: weights.tensors[name] for name in alike})
    return len(alike)


def copy_tensors(net: nn.Module, tensors: Mapping[str, Any]) -> None:
    """Copy tensors of the network's own names and shapes into it."""
    import torch

    own: dict[str, Any] = net.state_dict()
    with torch.no_grad():
        for name, tensor in tensors.items():
            own[name].copy_(torch.from_numpy(tensor.copy()))
