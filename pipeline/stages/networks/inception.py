"""Features of Inception v3 (Szegedy et al. 2016), by which the field's Frechet distance (FID) is
computed: weights of the user's, under the names of torchvision's `inception_v3`.

A block is a list of branches, each a chain of convolutions named `branchN_1`, `branchN_2` and so
on; `_2a` and `_2b` read the same input. All follow from the names in the file.
"""

import re
from collections.abc import Collection, Mapping
from itertools import groupby
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from pipeline.core.errors import FileProblem
from pipeline.stages.networks.published_weights import read_tensors
from pipeline.stages.networks.weights import Weights

SIDE = 299  # of the images that it was trained on
_BATCH_NORM_EPS = 1e-3
_STEM = ("1a_3x3", "2a_3x3", "2b_3x3", "pool", "3b_1x1", "4a_3x3", "pool")
_SAME_SIZE = ("2b_3x3", "3b_1x1")  # of the stem; its others are not padded
_HALVING = ("6a", "7a")
_BLOCKS = ("5b", "5c", "5d", "6a", "6b", "6c", "6d", "6e", "7a", "7b", "7c")
_N_LAYERS = 94  # convolutions, without those of the auxiliary classifier
_FILTERS = ".conv.weight"
_NORMAL = (".bn.running_mean", ".bn.running_var", ".bn.weight", ".bn.bias")  # as batch_norm takes
_LAYER = re.compile(r"(Conv2d|Mixed)_.*\.conv\.weight")


def read_inception(path: Path) -> Weights:
    """Weights in torchvision's layout; raises FileProblem for any other file."""

    def select(names: Collection[str]) -> Mapping[str, str]:
        layers = [name.removesuffix(_FILTERS) for name in names if _LAYER.fullmatch(name)]
        used = [f"{layer}{part}" for layer in layers for part in (_FILTERS, *_NORMAL)]
        if len(layers) != _N_LAYERS or not set(used) <= set(names):
            raise FileProblem(
                "not weights of Inception v3 under torchvision's names: "
                f"{len(layers)} of its {_N_LAYERS} convolutions are there",
                path,
            )
        return {name: name for name in used}

    tensors = read_tensors(path, select)[0]
    return Weights(name=path.stem, kind="inception", config={}, tensors=tensors)


def compute_features(weights: Weights, images: Tensor) -> Tensor:
    """Features (n, 2048) of images (n, 3, `SIDE`, `SIDE`) in -1..1."""
    tensors = {name: torch.tensor(array) for name, array in weights.tensors.items()}
    x = images
    for part in _STEM:
        if part == "pool":
            x = functional.max_pool2d(x, 3, 2)
        else:
            name = f"Conv2d_{part}"
            x = _convolve(tensors, name, x, part in _SAME_SIZE, 2 if part == "1a_3x3" else 1)
    for block in _BLOCKS:
        x = _run_block(tensors, f"Mixed_{block}.", x, halves=block in _HALVING)
    return x.mean(dim=(2, 3))


def _run_block(tensors: Mapping[str, Tensor], block: str, x: Tensor, *, halves: bool) -> Tensor:
    """The branches one after the other in the order of torchvision: the pooled one is the last."""
    layers = sorted(
        {name.removeprefix(block).split(".")[0] for name in tensors if name.startswith(block)},
        key=lambda layer: (layer == "branch_pool", len(layer.split("_")[0]), layer),
    )
    found: list[Tensor] = []
    for branch, chain in groupby(layers, lambda layer: layer.rpartition("_")[0] or layer):
        # branch_pool has no number
        result = [functional.avg_pool2d(x, 3, 1, 1) if branch == "branch" else x]
        steps = [list(step) for _, step in groupby(chain, lambda layer: layer.rstrip("ab"))]
        for step in steps:
            ends = halves and step is steps[-1]
            result = [
                _convolve(tensors, block + layer, result[0], not ends, 2 if ends else 1)
                for layer in step
            ]
        found += result
    return torch.cat([*found, functional.max_pool2d(x, 3, 2)] if halves else found, dim=1)


def _convolve(
    tensors: Mapping[str, Tensor], name: str, x: Tensor, is_padded: bool, stride: int
) -> Tensor:
    filters = tensors[name + _FILTERS]
    padding = [is_padded * (size // 2) for size in filters.shape[2:]]
    mean, variance, factor, offset = (tensors[name + part] for part in _NORMAL)
    x = functional.conv2d(x, filters, stride=stride, padding=padding)
    normal = functional.batch_norm(x, mean, variance, factor, offset, eps=_BATCH_NORM_EPS)
    return functional.relu(normal)
