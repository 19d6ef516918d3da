"""Reads weights of published networks under their original tensor names, or as Tactoscope writes
them; without torch.

- Depth Anything V2 (`depth_anything_v2_vits.pth` and so on) predicts relative depth of an image.
  The lab's fork
  (MMintLab/depth_anything_v2, `latest.pth`) predicts the distance from the camera in metres, as a
  share of a largest distance that its checkpoints do not state; of a depth sensor it sees the depth
  itself. Its files have the optimiser's state, or the fork's contact head.
- The paper's latent diffusion. Averaged (EMA) denoiser weights are used, as in the released
  sampler. The file holds the
  source encoder twice (`resnet.*` and `features.*`) and an unused classifier.
- The lab's U-Nets: depth of a gel (gelslim_depth) and contact of a bubble (Pytorch-UNet), with the
  same tensors under
  names that differ in `down1`, `up1` and so on against `down.0`, `up.0`. The normalisation is that
  of the published `unet_bigdata`, unless a description next to the file says otherwise.
- The paper's `VQ-VAE-small`.

What a file does not say of itself is read from a TOML of the same name next to it, such as
`latest.toml`.
"""

import re
from collections.abc import Callable, Collection, Mapping
from functools import wraps
from pathlib import Path

import numpy as np

from pipeline.core.errors import FileProblem
from pipeline.core.files import read_toml
from pipeline.core.params import Value
from pipeline.stages.networks.tensor_files import read_tensors, select_all
from pipeline.stages.networks.weights import (
    Weights,
    is_safetensors,
    is_tactoscope_file,
    load_tensors,
    load_weights,
)

# kinds of networks; and tasks
DEPTH_ANYTHING = "depth_anything"
LATENT = "latent"
U_NET = "unet"
VQVAE = "vqvae"
# (inputs, outputs) -> what it predicts
U_NET_TASKS = {(3, 1): "depth of a gel", (1, 2): "contact of a bubble"}
_DESCRIPTION = "the description of the weights"
_ENCODERS = {384: "vits", 768: "vitb", 1024: "vitl"}  # width -> name
_CONTACT_HEAD = "mask_head.mask_head.0.weight"
_TOKEN = "pretrained.cls_token"  # noqa: S105
_FEATURES = "depth_head.scratch.output_conv1.weight"
_LAST_DEPTH = "depth_head.scratch.output_conv2.2.weight"
_DEPTH_SETTINGS = {
    "answer": str,
    "largest_mm": float,
    "image_content": str,
    "side": int,
    "contact": bool,
}
_DENOISER = "model.diffusion_model."
_FIRST_STAGE = "first_stage_model."
_CONDITION = "cond_stage_model."
_AVERAGE = "model_ema."  # prefix; the parameter's name without dots follows
_LATENT_TENSORS = (
    f"{_DENOISER}input_blocks.0.0.weight",
    f"{_FIRST_STAGE}encoder.conv_in.weight",
    f"{_CONDITION}resnet.conv1.weight",
)
# of a U-Net
_FIRST_BLOCK = "inc.double_conv.0.weight"
_LAST_LAYER = "outc.conv.weight"
_NUMBERED = re.compile(r"^(down|up)([1-9])\.")
_U_NET_SETTINGS = {
    "rows": int,
    "cols": int,
    "min_depth_mm": float,
    "norm_scale": float,
    "uses_difference": bool,
}
# of the VQ-VAE
_ENCODER = "encoder.0.weight"
_DECODER = "decoder.5.weight"
_CODES = "codebook.embedding.weight"
ReadWeights = Callable[[Path], Weights]


def _or_own(kind: str) -> Callable[[ReadWeights], ReadWeights]:
    """Read a file that Tactoscope has written as it is, where it is of this kind, and others by
    the function.
    """

    def decorate(read: ReadWeights) -> ReadWeights:
        @wraps(read)
        def read_either(path: Path) -> Weights:
            if not (is_safetensors(path) and is_tactoscope_file(load_tensors(path)[0])):
                return read(path)
            weights = load_weights(path)
            if weights.kind != kind:
                raise FileProblem(f"these are weights of {weights.kind!r}, not of {kind!r}", path)
            return weights

        return read_either

    return decorate


@_or_own(DEPTH_ANYTHING)
def read_depth_anything(path: Path) -> Weights:
    """Read weights of Depth Anything V2; raises FileProblem for any other file."""
    table = read_tensors(path, lambda names: _select_depth_anything(names, path))
    tensors = table.tensors
    width = tensors[_TOKEN].shape[-1]
    if width not in _ENCODERS:
        raise FileProblem(
            f"unknown encoder of width {width}; supported are vits, vitb and vitl", path
        )
    is_fork = _CONTACT_HEAD in tensors or "optimizer" in table.other_keys
    usual: dict[str, Value] = (
        {"answer": "distance", "image_content": "frame"} if is_fork else {"answer": "relative"}
    )
    # The fork builds its head for the features of the small encoder, whatever the encoder; others
    # cannot be run.
    has_head = (
        _CONTACT_HEAD in tensors and tensors[_CONTACT_HEAD].shape[1] == tensors[_FEATURES].shape[1]
    )
    config = {
        "encoder": _ENCODERS[width],
        "contact": has_head,
        **usual,
        **_read_description(path, _DEPTH_SETTINGS),
    }
    if not config["contact"]:
        tensors = {
            name: tensor for name, tensor in tensors.items() if not name.startswith("mask_head.")
        }
    card = {"task": DEPTH_ANYTHING, "file": path.name}
    return Weights(name=path.stem, kind=DEPTH_ANYTHING, config=config, tensors=tensors, card=card)


def _select_depth_anything(names: Collection[str], path: Path) -> Mapping[str, str]:
    if not {_TOKEN, _FEATURES, _LAST_DEPTH} <= set(names):
        raise FileProblem(
            "not Depth Anything V2 weights: tensors pretrained.* and depth_head.* are missing", path
        )
    return select_all(names)


@_or_own(LATENT)
def read_latent_diffusion(path: Path) -> Weights:
    """Read a checkpoint of the released layout; raises FileProblem for any other file."""
    tensors = read_tensors(path, lambda names: _select_latent(names, path)).tensors
    unet, first, condition_channels = (tensors[name].shape[0] for name in _LATENT_TENSORS)
    config: dict[str, Value] = {
        "side": 256,
        "width": unet,
        "autoencoder_width": first,
        "condition_channels": condition_channels,
        "raw_condition": True,
        "half_turn": True,
        "trained_with_condition_dropout": False,
    }
    tensors["scale_factor"] = np.asarray(tensors.get("scale_factor", 1.0), np.float32).reshape(())
    card = {"task": LATENT, "file": path.name}
    return Weights(name=path.stem, kind=LATENT, config=config, tensors=tensors, card=card)


def _select_latent(names: Collection[str], path: Path) -> dict[str, str]:
    """Tensors that sampling needs, the denoiser's averaged where the file has them so.

    Raises FileProblem.
    """
    missing = [name for name in _LATENT_TENSORS if name not in names]
    if missing:
        raise FileProblem(
            f"not latent diffusion weights under their original names: {', '.join(missing)} "
            "missing",
            path,
        )
    unused = (f"{_CONDITION}features.", f"{_CONDITION}resnet.fc.", f"{_FIRST_STAGE}loss.")
    used = [
        name
        for name in names
        if name == "scale_factor"
        or (name.startswith((_CONDITION, _DENOISER, _FIRST_STAGE)) and not name.startswith(unused))
    ]
    averaged = {name: _AVERAGE + name.removeprefix("model.").replace(".", "") for name in used}
    return {name: averaged[name] if averaged[name] in names else name for name in used}


@_or_own(U_NET)
def read_unet(path: Path) -> Weights:
    """Read the state of a U-Net; raises FileProblem for any other file."""
    tensors = read_tensors(path, lambda names: _select_unet(names, path)).tensors
    first = tensors[_FIRST_BLOCK]
    last = tensors[_LAST_LAYER]
    levels = 1 + len({name.split(".")[1] for name in tensors if name.startswith("down.")})
    config: dict[str, Value] = {
        "inputs": first.shape[1],
        "outputs": last.shape[0],
        "width": first.shape[0],
    }
    task = U_NET_TASKS.get((first.shape[1], last.shape[0]))
    if task is None:
        raise FileProblem(
            f"this U-Net has {first.shape[1]} inputs and {last.shape[0]} outputs; supported are 3 "
            "and 1 for depth of "
            "a gel, 1 and 2 for contact of a bubble",
            path,
        )
    config |= {"levels": levels, **_read_description(path, _U_NET_SETTINGS)}
    card = {"task": task, "file": path.name}
    return Weights(name=path.stem, kind=U_NET, config=config, tensors=tensors, card=card)


def _select_unet(names: Collection[str], path: Path) -> dict[str, str]:
    found = {
        _NUMBERED.sub(lambda match: f"{match[1]}.{int(match[2]) - 1}.", name): name
        for name in names
    }
    missing = [name for name in (_FIRST_BLOCK, _LAST_LAYER, "up.0.up.weight") if name not in found]
    if missing:
        raise FileProblem(
            f"not weights of a U-Net with transposed convolutions: {', '.join(missing)} missing",
            path,
        )
    return found


@_or_own(VQVAE)
def read_vqvae(path: Path) -> Weights:
    """Read a state of the released VQ-VAE; raises FileProblem for any other file."""
    tensors = read_tensors(path, lambda names: _select_vqvae(names, path)).tensors
    codes, width = tensors[_CODES].shape
    config: dict[str, Value] = {
        "inputs": tensors[_ENCODER].shape[1],
        "outputs": tensors[_DECODER].shape[1],
        "width": width,
        "codes": codes,
        "half_turn": True,
    }
    card = {"task": VQVAE, "file": path.name}
    return Weights(name=path.stem, kind=VQVAE, config=config, tensors=tensors, card=card)


def _select_vqvae(names: Collection[str], path: Path) -> Mapping[str, str]:
    if not {_ENCODER, _DECODER, _CODES} <= set(names):
        raise FileProblem(
            f"not VQ-VAE weights under their original names: {_ENCODER}, {_CODES} or {_DECODER} "
            "is missing",
            path,
        )
    return select_all(names)


READERS: Mapping[str, ReadWeights] = {
    DEPTH_ANYTHING: read_depth_anything,
    LATENT: read_latent_diffusion,
    U_NET: read_unet,
    VQVAE: read_vqvae,
}


def get_description_path(weights: Path) -> Path:
    """The file of the description of weights, which may not be there."""
    return weights.with_suffix(".toml")


def _read_description(weights: Path, known: Mapping[str, type]) -> dict[str, Value]:
    """The values next to a weights file, by the names and types `known`.

    Empty where there is no description.

    Raises FileProblem for an unknown name or a value of another type.
    """
    path = get_description_path(weights)
    if not path.is_file():
        return {}
    values = read_toml(path, _DESCRIPTION)
    for name, value in values.items():
        if name not in known:
            raise FileProblem(
                f"{_DESCRIPTION} has {name!r}; known are {', '.join(known)}", path, field=name
            )
        if known[name] is float and type(value) is int:
            values[name] = float(value)
        elif type(value) is not known[name]:
            wanted = known[name].__name__
            raise FileProblem(
                f"{name} in {_DESCRIPTION} must be a {wanted}, got {value!r}", path, field=name
            )
    return values
