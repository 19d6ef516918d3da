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

Reads tensors of foreign files, safetensors or torch's, without executing code.
"""

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import wraps
from operator import itemgetter
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats
from pipeline.core.errors import FileProblem
from pipeline.core.files import MOST_NETWORK_BYTES, read_toml, require_budget
from pipeline.core.params import Value
from pipeline.core.progress import report_reading
from pipeline.core.torch_archive import load_torch_file, require_checksums
from pipeline.stages.networks.weights import (
    Weights,
    is_safetensors,
    is_tactoscope_file,
    load_tensors,
    load_weights,
)

# share of the names; the largest part of a network that is read, an encoder, holds 0.83
_SHARED_BY = 0.9
_MOST_TENSOR_BYTES = 1 << 28  # of one tensor; the largest of a latent diffusion takes 0.12 GB
_MAX_PREFIXES = 8  # such as `module.model.` of wrappers within each other
_MAX_NESTING = 3  # levels of a training checkpoint that are searched for the table of tensors
# names in the file -> name wanted: name in the file
Selection = Callable[[Collection[str]], Mapping[str, str]]


def select_all(names: Collection[str]) -> Mapping[str, str]:
    """Every tensor under its name."""
    return {name: name for name in names}


def read_tensors(
    path: Path, select: Selection = select_all
) -> tuple[dict[str, Floats], frozenset[str]]:
    """The selected tensors as float32, and the keys next to their table, such as "optimizer".

    Of a torch archive no other tensors are read. A prefix that nearly all names share, such as that
    of distributed training, is dropped before `select` sees them. `select` may raise FileProblem.
    Raises FileProblem if the file is not a table of finite tensors.
    """
    if is_safetensors(path):
        stored = _drop_prefix(load_tensors(path)[1])
        wanted = select(stored.keys())
        return {name: _convert(stored[its], path) for name, its in wanted.items()}, frozenset()
    require_checksums(path)
    table, others = _find_table(load_torch_file(path), path)
    return _read_selected(table, select(table.keys()), path), others


def _read_selected(
    table: Mapping[str, Any], wanted: Mapping[str, str], path: Path
) -> dict[str, Floats]:
    total = sum(table[stored].numel() for stored in wanted.values())
    done = 0
    require_budget(4 * total, "the weights", path, most=MOST_NETWORK_BYTES)
    for stored in wanted.values():
        require_budget(
            4 * table[stored].numel(), f"the tensor {stored!r}", path, most=_MOST_TENSOR_BYTES
        )
    tensors: dict[str, Floats] = {}
    for name, stored in wanted.items():
        tensor = table[stored].detach()
        if tensor.is_complex() or tensor.is_sparse or tensor.is_quantized:
            raise FileProblem("a tensor has a type of numbers that is not supported", path)
        tensors[name] = _convert(tensor.float().numpy(), path)
        done += tensor.numel()
        report_reading(done / max(total, 1), f"reading {path.name}")
    return tensors


def _find_table(content: Any, path: Path) -> tuple[dict[str, Any], frozenset[str]]:
    """The table of tensors of a checkpoint, and the keys next to it.

    Raises FileProblem if there is none.

    The table is the mapping with most tensors, the first of several: averages and the optimiser's
    state follow it.
    """
    tables = list(_list_tables(content, (), set()))
    if not tables:
        raise FileProblem(
            "the weights are not a table of named tensors; save the network's state_dict", path
        )
    table, above = max(tables, key=lambda found: len(found[0]))
    return _drop_prefix(table), frozenset(
        str(key) for outer, inner in above for key in outer if key != inner
    )


# mappings around a table, each with the key of the next one
_Place = tuple[tuple[Mapping[Any, Any], Any], ...]


def _list_tables(
    content: Any, above: _Place, seen: set[int]
) -> Iterator[tuple[dict[str, Any], _Place]]:
    """Mappings that hold tensors under names, outer ones first, each once, with those around it."""
    if not isinstance(content, Mapping) or len(above) == _MAX_NESTING or id(content) in seen:
        return
    seen.add(id(content))
    named = cast("Mapping[Any, Any]", content)
    table = {
        name: tensor
        for name, tensor in named.items()
        if isinstance(name, str) and hasattr(tensor, "shape")
    }
    if table:
        yield table, above
    for key, value in named.items():
        yield from _list_tables(value, (*above, (named, key)), seen)


def _drop_prefix(table: dict[str, Any]) -> dict[str, Any]:
    """The table without the parts in front that nearly all its names share, such as `module.`.

    The few others are those of a wrapper: a counter of averages, a metric, a weighted loss.
    """
    for _ in range(_MAX_PREFIXES):
        firsts = Counter(name.partition(".")[0] for name in table if "." in name)
        first, count = max(firsts.items(), key=itemgetter(1), default=("", 0))
        if len(table) < 2 or count < _SHARED_BY * len(table):
            return table
        table = {
            name.partition(".")[2]: tensor
            for name, tensor in table.items()
            if name.startswith(f"{first}.")
        }
    return table


def _convert(tensor: NDArray[Any], path: Path) -> Floats:
    """The tensor as float32; filters in channels-last order, in which networks use them, so that
    none copies them.
    """
    values = np.asarray(tensor, np.float32)
    if not np.isfinite(values).all():
        raise FileProblem("the weights contain NaN or infinity; download them again", path)
    if values.ndim != 4:
        return np.ascontiguousarray(values).reshape(values.shape)
    return np.ascontiguousarray(values.transpose(0, 2, 3, 1)).transpose(0, 3, 1, 2)


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


def _require(path: Path, message: str, *wanted: str) -> Selection:
    """A selection of all tensors of a file that has those wanted; raises FileProblem."""

    def select(names: Collection[str]) -> Mapping[str, str]:
        if not set(wanted) <= set(names):
            raise FileProblem(message, path)
        return select_all(names)

    return select


def _make_weights(
    path: Path, kind: str, config: Mapping[str, Value], tensors: Mapping[str, Floats], task: str
) -> Weights:
    card = {"task": task, "file": path.name}
    return Weights(name=path.stem, kind=kind, config=config, tensors=tensors, card=card)


@_or_own(DEPTH_ANYTHING)
def read_depth_anything(path: Path) -> Weights:
    """Read weights of Depth Anything V2; raises FileProblem for any other file."""
    missing = "not Depth Anything V2 weights: tensors pretrained.* and depth_head.* are missing"
    select = _require(path, missing, _TOKEN, _FEATURES, _LAST_DEPTH)
    tensors, other_keys = read_tensors(path, select)
    width = tensors[_TOKEN].shape[-1]
    if width not in _ENCODERS:
        raise FileProblem(
            f"unknown encoder of width {width}; supported are vits, vitb and vitl", path
        )
    is_fork = _CONTACT_HEAD in tensors or "optimizer" in other_keys
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
    return _make_weights(path, DEPTH_ANYTHING, config, tensors, DEPTH_ANYTHING)


@_or_own(LATENT)
def read_latent_diffusion(path: Path) -> Weights:
    """Read a checkpoint of the released layout; raises FileProblem for any other file."""
    tensors = read_tensors(path, lambda names: _select_latent(names, path))[0]
    unet, first, condition_channels = (tensors[name].shape[0] for name in _LATENT_TENSORS)
    config: dict[str, Value] = {
        "side": 256,
        "width": unet,
        "autoencoder_width": first,
        "condition_channels": condition_channels,
        "raw_condition": True,
        "half_turn": True,
        "leading_times": True,
        "trained_with_condition_dropout": False,
    }
    tensors["scale_factor"] = np.asarray(tensors.get("scale_factor", 1.0), np.float32).reshape(())
    return _make_weights(path, LATENT, config, tensors, LATENT)


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
    tensors = read_tensors(path, lambda names: _select_unet(names, path))[0]
    width, inputs = tensors[_FIRST_BLOCK].shape[:2]
    outputs = tensors[_LAST_LAYER].shape[0]
    task = U_NET_TASKS.get((inputs, outputs))
    if task is None:
        raise FileProblem(
            f"this U-Net has {inputs} inputs and {outputs} outputs; supported are 3 and 1 for "
            "depth of a gel, 1 and 2 for contact of a bubble",
            path,
        )
    config: dict[str, Value] = {
        "inputs": inputs,
        "outputs": outputs,
        "width": width,
        "levels": 1 + len({name.split(".")[1] for name in tensors if name.startswith("down.")}),
        **_read_description(path, _U_NET_SETTINGS),
    }
    return _make_weights(path, U_NET, config, tensors, task)


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
    missing = (
        f"not VQ-VAE weights under their original names: {_ENCODER}, {_CODES} or {_DECODER} "
        "is missing"
    )
    tensors = read_tensors(path, _require(path, missing, _ENCODER, _DECODER, _CODES))[0]
    codes, width = tensors[_CODES].shape
    config: dict[str, Value] = {
        "inputs": tensors[_ENCODER].shape[1],
        "outputs": tensors[_DECODER].shape[1],
        "width": width,
        "codes": codes,
        "half_turn": True,
    }
    return _make_weights(path, VQVAE, config, tensors, VQVAE)


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
            raise FileProblem(f"{_DESCRIPTION} has {name!r}; known are {', '.join(known)}", path)
        if known[name] is float and type(value) is int:
            values[name] = float(value)
        elif type(value) is not known[name]:
            wanted = known[name].__name__
            raise FileProblem(f"{name} in {_DESCRIPTION} must be a {wanted}, got {value!r}", path)
    return values
