"""Reads weights of the latent diffusion: released checkpoints and Tactoscope files, distinguished by tensor names."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.errors import FileProblem
from pipeline.base.params import Value
from pipeline.networks.tensor_files import read_tensors
from pipeline.networks.weights import SUFFIX, Weights, is_tactoscope_file, load_tensors, load_weights

KIND = TASK = "latent"
_UNET, _FIRST, _CONDITION = "model.diffusion_model.", "first_stage_model.", "cond_stage_model."
_AVERAGE = "model_ema."  # prefix; the parameter's name without dots follows
_REQUIRED_TENSORS = (
    f"{_UNET}input_blocks.0.0.weight",
    f"{_FIRST}encoder.conv_in.weight",
    f"{_CONDITION}resnet.conv1.weight",
)


def read_weights(path: Path) -> Weights:
    """Read Tactoscope weights or a checkpoint of the released layout; raises FileProblem for any other file.

    Averaged (EMA) denoiser weights are used, as in the released sampler. The file holds the source encoder twice
    (`resnet.*` and `features.*`) and an unused classifier.
    """
    if path.suffix == SUFFIX and is_tactoscope_file(load_tensors(path)[0]):
        return load_weights(path)
    tensors_in_file = read_tensors(path)
    if not set(_REQUIRED_TENSORS) <= tensors_in_file.keys():
        raise FileProblem(
            f"not latent diffusion weights under their original names: {', '.join(_REQUIRED_TENSORS)} are missing",
            path,
        )
    unet, first, condition_channels = (tensors_in_file[name].shape[0] for name in _REQUIRED_TENSORS)
    config: dict[str, Value] = {
        "side": 256, "width": unet, "autoencoder_width": first, "condition_channels": condition_channels,
        "raw_condition": True, "half_turn": True, "trained_with_condition_dropout": False,
    }  # fmt: skip
    tensors = {name: _get_averaged(tensors_in_file, name) for name in tensors_in_file if _is_used(name)}
    tensors["scale_factor"] = np.asarray(tensors_in_file.get("scale_factor", np.float32(1.0)), np.float32).reshape(())
    return Weights(name=path.stem, kind=KIND, config=config, tensors=tensors, card={"task": TASK, "file": path.name})


def _is_used(name: str) -> bool:
    if name.startswith(_CONDITION):
        return not name.startswith((f"{_CONDITION}features.", f"{_CONDITION}resnet.fc."))
    return name.startswith(_UNET) or (name.startswith(_FIRST) and not name.startswith(f"{_FIRST}loss."))


def _get_averaged(tensors_in_file: dict[str, Floats], name: str) -> Floats:
    """The averaged tensor if the file has one, else the tensor."""
    return tensors_in_file.get(_AVERAGE + name.removeprefix("model.").replace(".", ""), tensors_in_file[name])
