"""The objects of simulated touches: which ones a data split holds, how one is sampled, and the
samples made of them.
"""

import io
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar, cast

import numpy as np

from pipeline.core.arrays import freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.files import open_atomic, read_cached_arrays
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.memo import Memo
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.random_bodies import make_random_body

DataSplit = Literal["training", "unseen_grasps", "unseen_tools", "all_objects"]
DATA_SPLITS: tuple[DataSplit, ...] = ("training", "unseen_grasps", "unseen_tools", "all_objects")
"""`training` adds random bodies to the training objects. `all_objects` are training objects and
unseen tools, for networks that see one sensor alone. The position of a split is part of its random
seeds.
"""
_SMALL_MM = 6.0, 17.0  # extent of small bodies
_MAX_EMPTY = 100  # touches in a row without contact
T = TypeVar("T")


def sample_object(
    split: DataSplit,
    rng: np.random.Generator,
    index: int,
    *,
    catalogue_share: float,
    small_share: float = 0.0,
    outline_share: float = 0.0,
) -> tuple[str, Mesh]:
    """Name and mesh of object `index` of a split; the name "" is a random body.

    In training, `catalogue_share` are training objects and the rest random bodies, `small_share` of
    them small and with nothing behind their pattern, `outline_share` of the patterns rims. Other
    splits go through their objects in order.
    """
    if split == "training" and rng.random() >= catalogue_share:
        make = _make_small_body if small_share and rng.random() < small_share else make_random_body
        return "", make(rng, outline_share=outline_share)
    names = {
        "training": shapes.list_shapes("training"),
        "unseen_grasps": shapes.list_shapes("training"),
        "unseen_tools": shapes.list_shapes("unseen"),
        "all_objects": shapes.list_labelled_shapes(),
    }[split]
    name = names[int(rng.integers(len(names))) if split == "training" else index % len(names)]
    return name, shapes.make_shape(name).mesh


def find_next_contact(
    simulate: Callable[[int], T | None], index: int, none: str = "no contact in"
) -> T:
    """Touch `index`, or the next one that `simulate` returns.

    Raises SettingProblem after a hundred without contact.
    """
    for k in range(index, index + _MAX_EMPTY):
        touch = simulate(k)
        if touch is not None:
            return touch
    raise SettingProblem(f"{none} {_MAX_EMPTY} touches from {index} on; choose another press_seed")


def _make_small_body(rng: np.random.Generator, *, outline_share: float) -> Mesh:
    """A random pattern on its own walls, scaled so that a gel feels nearly all of it."""
    large = make_random_body(rng, unsupported_share=1.0, outline_share=outline_share)
    extent = float(np.ptp(large.vertices_mm[:, :2], axis=0).max())
    scale = min(1.0, rng.uniform(*_SMALL_MM) / extent)
    return replace(large, vertices_mm=freeze(large.vertices_mm * (scale, scale, 1.0)))


class SampleCache(Generic[T]):
    """Simulated samples of one dataclass by name: in memory up to `max_bytes`, and in a folder
    where one is given.

    A simulation takes a tenth of a second and training draws each sample many times. A sample is a
    frozen dataclass of arrays and texts.
    """

    def __init__(self, kind: type[T], *, max_bytes: int = 1 << 30) -> None:
        self._kind = kind
        self._memory: Memo[str, T] = Memo(most_bytes=max_bytes)

    def get(self, name: str, folder: str, make: Callable[[], T], **unstored: Any) -> T:
        """Sample `name`: from memory, from `folder`/`name`.npz, or made. An empty `folder` stores
        nothing.

        `unstored` fields are cheap to compute and not written.
        """

        def load_or_make() -> T:
            path = Path(folder) / f"{name}.npz"
            arrays = read_cached_arrays(path) if folder else None
            # a file that is missing, cut short or of other fields is made again
            if arrays is not None and arrays.keys() | unstored.keys() == names:
                values = {
                    key: str(array) if array.dtype.kind == "U" else freeze(array)
                    for key, array in arrays.items()
                }
                return self._kind(**values, **unstored)
            sample = make()
            if folder:
                content = io.BytesIO()
                np.savez(content, **{key: getattr(sample, key) for key in names - unstored.keys()})
                path.parent.mkdir(parents=True, exist_ok=True)
                with open_atomic(path, "a training sample", None) as file:
                    file.write(content.getbuffer())
            return sample

        names = {field.name for field in fields(cast("Any", self._kind))}
        return self._memory.get_or_make(name, load_or_make)

    def clear(self) -> None:
        """Free the memory; files stay."""
        self._memory.clear()
