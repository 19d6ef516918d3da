"""Published and own weights of the latent diffusion: told apart by the names and shapes of their tensors."""

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
_AVERAGE = "model_ema."  # followed by a parameter's name without its dots
_WANTED = (f"{_UNET}input_blocks.0.0.weight", f"{_FIRST}encoder.conv_in.weight", f"{_CONDITION}resnet.conv1.weight")


def read_weights(path: Path) -> Weights:
    """Ours, or a checkpoint of the released layout; raises FileProblem where it is neither.

    Of the denoiser its averaged weights are taken, as the released sampler does. The source's encoder stands twice in
    such a file (`resnet.*` and `features.*`), and its classifier is of no use.
    """
    if path.suffix == SUFFIX and is_tactoscope_file(load_tensors(path)[0]):
        return load_weights(path)
    held = read_tensors(path)
    if not set(_WANTED) <= held.keys():
        raise FileProblem(
            f"these are no weights of the paper's latent diffusion under their original names ({', '.join(_WANTED)})",
            path,
        )
    unet, first, seen = (held[name].shape[0] for name in _WANTED)
    config: dict[str, Value] = {
        "side": 256, "width": unet, "autoencoder_width": first, "condition_channels": seen, "raw_condition": True, "half_turn": True,
    }  # fmt: skip
    tensors = {name: _averaged(held, name) for name in held if _is_used(name)}
    tensors["scale_factor"] = np.asarray(held.get("scale_factor", np.float32(1.0)), np.float32).reshape(())
    return Weights(name=path.stem, kind=KIND, config=config, tensors=tensors, card={"task": TASK, "file": path.name})


def _is_used(name: str) -> bool:
    if name.startswith(_CONDITION):
        return not name.startswith((f"{_CONDITION}features.", f"{_CONDITION}resnet.fc."))
    return name.startswith(_UNET) or (name.startswith(_FIRST) and not name.startswith(f"{_FIRST}loss."))


def _averaged(held: dict[str, Floats], name: str) -> Floats:
    """A tensor, or its average over the training where there is one."""
    return held.get(_AVERAGE + name.removeprefix("model.").replace(".", ""), held[name])
