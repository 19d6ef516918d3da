"""Tensors that others have written: safetensors, or a file of torch's, read without running any code."""

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

_WRAPPED = ("model", "state_dict", "model_state_dict")  # keys that training scripts put the tensors under


def read_tensors(path: Path) -> dict[str, Floats]:
    """Every tensor of a file by its name, as float32; raises FileProblem for what is no table of finite tensors."""
    if path.suffix == SUFFIX:
        return load_tensors(path)[1]
    return _of_torch(path)


def _of_torch(path: Path) -> dict[str, Floats]:
    content = read_bytes(path, "the weights")
    import torch

    try:
        held: Any = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except Exception as error:  # torch's errors of a damaged file have no common root
        raise FileProblem(
            "the weights cannot be read: the file is cut short or damaged, no file of torch's, or holds code", path
        ) from error
    for key in _WRAPPED:
        if isinstance(held, Mapping) and isinstance(held.get(key), Mapping):
            held = held[key]
    if not isinstance(held, Mapping):
        raise FileProblem("the weights are no table of tensors by name", path)
    tensors: dict[str, Floats] = {}
    for name, tensor in cast("Mapping[Any, Any]", held).items():
        if isinstance(tensor, torch.Tensor):
            tensors[str(name)] = np.array(tensor.float().numpy(), order="C")
    if not all(np.isfinite(tensor).all() for tensor in tensors.values()):
        raise FileProblem("the weights hold values that are not numbers; fetch them anew", path)
    return tensors
