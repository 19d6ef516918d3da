"""Reads tensors of foreign files, safetensors or torch's, without executing code."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.errors import FileProblem
from pipeline.base.files import read_bytes
from pipeline.networks.weights import SUFFIX, load_tensors

_WRAPPED = ("model", "state_dict", "model_state_dict")  # keys of the tensor table in training checkpoints


def read_tensors(path: Path) -> dict[str, Floats]:
    """All tensors of a file by name, as float32; raises FileProblem if it is not a table of finite tensors."""
    if path.suffix == SUFFIX:
        return load_tensors(path)[1]
    return _read_torch_file(path)


def _read_torch_file(path: Path) -> dict[str, Floats]:
    content = read_bytes(path, "the weights")
    import torch

    try:
        loaded: Any = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except Exception as error:  # torch's errors for damaged files have no common base
        raise FileProblem(
            "cannot read the weights: the file is truncated, damaged, not a torch file, or contains code", path
        ) from error
    for key in _WRAPPED:
        if isinstance(loaded, Mapping) and isinstance(loaded.get(key), Mapping):
            loaded = loaded[key]
    if not isinstance(loaded, Mapping):
        raise FileProblem("the weights are not a table of named tensors", path)
    tensors: dict[str, Floats] = {}
    for name, tensor in cast("Mapping[Any, Any]", loaded).items():
        if isinstance(tensor, torch.Tensor):
            tensors[str(name)] = np.array(tensor.float().numpy(), order="C")
    if not all(np.isfinite(tensor).all() for tensor in tensors.values()):
        raise FileProblem("the weights contain NaN or infinity; download them again", path)
    return tensors
