"""Reads weights of the lab's U-Nets: depth of a gel (gelslim_depth) and contact of a bubble (Pytorch-UNet).

Both have the same tensors, under names that differ in `down1`, `up1` and so on against `down.0`, `up.0`.
"""

import re
from collections.abc import Collection
from pathlib import Path

from pipeline.base.errors import FileProblem
from pipeline.base.params import Value
from pipeline.networks.tensor_files import read_tensors
from pipeline.networks.weights import SUFFIX, Weights, is_tactoscope_file, load_tensors, load_weights
from pipeline.networks.weights_description import read_description

KIND = "unet"
TASKS = {(3, 1): "depth of a gel", (1, 2): "contact of a bubble"}  # (inputs, outputs) -> what it predicts
_FIRST, _LAST = "inc.double_conv.0.weight", "outc.conv.weight"
_NUMBERED = re.compile(r"^(down|up)([1-9])\.")
_DESCRIBED = {"rows": int, "cols": int, "min_depth_mm": float, "norm_scale": float, "uses_difference": bool}


def read_weights(path: Path) -> Weights:
    """Read such a state, or Tactoscope weights; raises FileProblem for any other file.

    The normalisation is that of the published `unet_bigdata`, unless a description next to the file says otherwise.
    """
    if path.suffix == SUFFIX and is_tactoscope_file(load_tensors(path)[0]):
        return load_weights(path)
    tensors = read_tensors(path, lambda names: _select(names, path)).tensors
    first, last = tensors[_FIRST], tensors[_LAST]
    levels = 1 + len({name.split(".")[1] for name in tensors if name.startswith("down.")})
    config: dict[str, Value] = {"inputs": first.shape[1], "outputs": last.shape[0], "width": first.shape[0]}
    task = TASKS.get((first.shape[1], last.shape[0]))
    if task is None:
        raise FileProblem(
            f"this U-Net has {first.shape[1]} inputs and {last.shape[0]} outputs; supported are 3 and 1 for depth of "
            "a gel, 1 and 2 for contact of a bubble",
            path,
        )
    config |= {"levels": levels, **read_description(path, _DESCRIBED)}
    return Weights(name=path.stem, kind=KIND, config=config, tensors=tensors, card={"task": task, "file": path.name})


def _select(names: Collection[str], path: Path) -> dict[str, str]:
    found = {_NUMBERED.sub(lambda match: f"{match[1]}.{int(match[2]) - 1}.", name): name for name in names}
    missing = [name for name in (_FIRST, _LAST, "up.0.up.weight") if name not in found]
    if missing:
        raise FileProblem(f"not weights of a U-Net with transposed convolutions: {', '.join(missing)} missing", path)
    return found
