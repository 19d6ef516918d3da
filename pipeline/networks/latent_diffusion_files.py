"""Reads weights of the latent diffusion: released checkpoints and Tactoscope files, distinguished by tensor names."""

from collections.abc import Collection
from pathlib import Path

import numpy as np

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
    tensors = read_tensors(path, lambda names: _select(names, path)).tensors
    unet, first, condition_channels = (tensors[name].shape[0] for name in _REQUIRED_TENSORS)
    config: dict[str, Value] = {
        "side": 256, "width": unet, "autoencoder_width": first, "condition_channels": condition_channels,
        "raw_condition": True, "half_turn": True, "trained_with_condition_dropout": False,
    }  # fmt: skip
    tensors["scale_factor"] = np.asarray(tensors.get("scale_factor", 1.0), np.float32).reshape(())
    return Weights(name=path.stem, kind=KIND, config=config, tensors=tensors, card={"task": TASK, "file": path.name})


def _select(names: Collection[str], path: Path) -> dict[str, str]:
    """Tensors that sampling needs, the denoiser's averaged; raises FileProblem."""
    missing = [name for name in _REQUIRED_TENSORS if name not in names]
    if missing:
        raise FileProblem(
            f"not latent diffusion weights under their original names: {', '.join(missing)} missing", path
        )
    return {name: _get_averaged(names, name) for name in names if _is_used(name)}


def _is_used(name: str) -> bool:
    if name.startswith(_CONDITION):
        return not name.startswith((f"{_CONDITION}features.", f"{_CONDITION}resnet.fc."))
    return (
        name == "scale_factor"
        or name.startswith(_UNET)
        or (name.startswith(_FIRST) and not name.startswith(f"{_FIRST}loss."))
    )


def _get_averaged(names: Collection[str], name: str) -> str:
    """The name of the averaged tensor if the file has one, else of the tensor."""
    averaged = _AVERAGE + name.removeprefix("model.").replace(".", "")
    return averaged if averaged in names else name
