"""The turns that map a recording's object onto itself, kept beside its mesh."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.base.arrays import Doubles, freeze
from pipeline.base.errors import FileProblem
from pipeline.recordings import hdf5_layout as layout
from pipeline.recordings import hdf5_validation as border

if TYPE_CHECKING:  # the shapes are many, and a reader needs none of them
    from pipeline.geometry.symmetry import Symmetry

_MOST = 1000  # turns; an icosahedron has 60
_EXACT = 1e-6  # largest entry of R^T R - 1, and of |axis| - 1


def write(group: Any, symmetry: Symmetry) -> None:
    """Put `symmetry` into the group of the object."""
    inside = group.create_group("symmetry")
    for key, values in (("rotations", symmetry.rotations), ("axis", symmetry.axis)):
        if values is not None:
            dataset = inside.create_dataset(key, data=values, chunks=values.shape, fletcher32=True)
            dataset.attrs["unit"] = layout.UNITS[f"symmetry/{key}"]


def read(group: Any, path: Path) -> Symmetry | None:
    """What `write` was given; None where the recording does not say.

    Raises FileProblem for turns that are none, for an axis without direction, and for a group without the identity.
    """
    if "symmetry" not in group:
        return None
    from pipeline.geometry.symmetry import Symmetry

    inside = group["symmetry"]
    stored = border.require_dataset(inside, "rotations", "1", border.FLOAT_KINDS, (None, 3, 3), path)
    rotations: Doubles = stored[: _MOST + 1].astype(np.float64)
    axis = None
    if "axis" in inside:
        axis = border.require_dataset(inside, "axis", "1", border.FLOAT_KINDS, (3,), path)[()].astype(np.float64)
    proper = 0 < len(rotations) <= _MOST
    proper = proper and bool(np.abs(rotations.transpose(0, 2, 1) @ rotations - np.eye(3)).max() < _EXACT)
    proper = (
        proper and bool((np.linalg.det(rotations) > 0).all()) and bool(np.abs(rotations[0] - np.eye(3)).max() < _EXACT)
    )
    if not proper or (axis is not None and not abs(np.linalg.norm(axis) - 1.0) < _EXACT):
        raise FileProblem("the object's symmetry is no set of turns that begins with none at all", path,
                          field="object/symmetry")  # fmt: skip
    return Symmetry(rotations=freeze(rotations), axis=None if axis is None else freeze(axis))
