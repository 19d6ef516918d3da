"""How far points lie from a posed object: what the Pose column shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.base.arrays import Doubles
from pipeline.geometry import rigid
from pipeline.geometry.distance_grid_store import distance_grid
from pipeline.geometry.meshes import Mesh


class ObjectSurface:
    """The signed distances of a mesh, as the pose was registered to them."""

    def __init__(self, mesh: Mesh) -> None:
        self._grid = distance_grid(mesh)

    def distances_mm(self, points_mm: ArrayLike, sensor_from_object: Doubles) -> NDArray[np.float32]:
        """Signed distances (n,) of points in the sensor frame, positive outside the object."""
        return self._grid.at(rigid.apply(rigid.invert(sensor_from_object), points_mm))[0].astype(np.float32)
