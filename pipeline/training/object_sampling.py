"""The objects of simulated touches: which ones a data split holds, and how one is sampled."""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal, TypeVar

import numpy as np

from pipeline.base.arrays import freeze
from pipeline.base.errors import SettingProblem
from pipeline.geometry.meshes import Mesh
from pipeline.simulation import shapes
from pipeline.simulation.random_bodies import make_random_body

DataSplit = Literal["training", "unseen_grasps", "unseen_tools", "all_objects"]
DATA_SPLITS: tuple[DataSplit, ...] = ("training", "unseen_grasps", "unseen_tools", "all_objects")
"""`training` adds random bodies to the training objects. `all_objects` are training objects and unseen tools, for
networks that see one sensor alone. The position of a split is part of its random seeds.
"""
_SMALL_MM = 6.0, 17.0  # extent of small bodies
_MAX_EMPTY = 100  # touches in a row without contact
T = TypeVar("T")


def sample_object(
    split: DataSplit, rng: np.random.Generator, index: int, *, catalogue_share: float, small_share: float = 0.0
) -> tuple[str, Mesh]:
    """Name and mesh of object `index` of a split; the name "" is a random body.

    In training, `catalogue_share` are training objects and the rest random bodies, `small_share` of them small and with
    nothing behind their pattern. Other splits go through their objects in order.
    """
    if split == "training" and rng.random() >= catalogue_share:
        return "", _make_small_body(rng) if small_share and rng.random() < small_share else make_random_body(rng)
    names = {
        "training": shapes.list_shapes("training"), "unseen_grasps": shapes.list_shapes("training"),
        "unseen_tools": shapes.list_shapes("unseen"), "all_objects": shapes.list_labelled_shapes(),
    }[split]  # fmt: skip
    name = names[int(rng.integers(len(names))) if split == "training" else index % len(names)]
    return name, shapes.make_shape(name).mesh


def find_next_contact(simulate: Callable[[int], T | None], index: int) -> T:
    """Touch `index`, or the next one that `simulate` returns; raises SettingProblem after a hundred without contact."""
    for k in range(index, index + _MAX_EMPTY):
        touch = simulate(k)
        if touch is not None:
            return touch
    raise SettingProblem(f"no contact in {_MAX_EMPTY} touches from {index} on; choose another press_seed")


def _make_small_body(rng: np.random.Generator) -> Mesh:
    """A random pattern on its own walls, scaled so that a gel feels nearly all of it."""
    large = make_random_body(rng, unsupported_share=1.0)
    extent = float(np.ptp(large.vertices_mm[:, :2], axis=0).max())
    scale = min(1.0, rng.uniform(*_SMALL_MM) / extent)
    return replace(large, vertices_mm=freeze(large.vertices_mm * (scale, scale, 1.0)))
