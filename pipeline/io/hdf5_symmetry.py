"""Rotations that map a recording's object onto itself, stored with its mesh."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import FileProblem
from pipeline.io import hdf5_layout as layout
from pipeline.io import hdf5_validation as validation

if TYPE_CHECKING:  # imported on use
    from pipeline.core.geometry.symmetry import Symmetry

_MAX_ROTATIONS = 1000  # an icosahedron has 60
_TOLERANCE = 1e-6  # largest entry of R^T R - 1, and of |axis| - 1


def write(group: Any, symmetry: Symmetry) -> None:
    """Write `symmetry` into the group of the object."""
    symmetry_group = group.create_group("symmetry")
    for key, values in (("rotations", symmetry.rotations), ("axis", symmetry.axis)):
        if values is not None:
            dataset = symmetry_group.create_dataset(
                key, data=values, chunks=values.shape, fletcher32=True
            )
            dataset.attrs["unit"] = layout.UNITS[f"symmetry/{key}"]


def read(group: Any, path: Path) -> Symmetry | None:
    """The symmetry of the object; None where the recording has none.

    Raises FileProblem for matrices that are no rotations, an axis of another length than 1, or a
    missing identity.
    """
    if "symmetry" not in group:
        return None
    from pipeline.core.geometry.symmetry import Symmetry

    symmetry_group = group["symmetry"]
    stored = validation.require_dataset(
        symmetry_group, "rotations", "1", validation.FLOAT_KINDS, (None, 3, 3), path
    )
    rotations: Doubles = stored[: _MAX_ROTATIONS + 1].astype(np.float64)
    axis = None
    if "axis" in symmetry_group:
        axis = validation.require_dataset(
            symmetry_group, "axis", "1", validation.FLOAT_KINDS, (3,), path
        )[()].astype(np.float64)
    is_valid = 0 < len(rotations) <= _MAX_ROTATIONS
    is_valid = is_valid and bool(
        np.abs(rotations.transpose(0, 2, 1) @ rotations - np.eye(3)).max() < _TOLERANCE
    )
    is_valid = is_valid and bool((np.linalg.det(rotations) > 0).all())
    is_valid = is_valid and bool(np.abs(rotations[0] - np.eye(3)).max() < _TOLERANCE)
    if not is_valid or (axis is not None and not abs(np.linalg.norm(axis) - 1.0) < _TOLERANCE):
        raise FileProblem(
            "the object's symmetry must be rotations that begin with the identity",
            path,
            field="object/symmetry",
        )
    return Symmetry(rotations=freeze(rotations), axis=None if axis is None else freeze(axis))
