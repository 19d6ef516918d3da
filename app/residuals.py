"""How far points lie from a posed object: what the Pose column shows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline import rigid
from pipeline.arrays import Doubles
from pipeline.meshes import Mesh, sample_surface

N_SAMPLES = 30_000  # on a 40 mm object 0.3 mm apart; the plane through each sample closes the rest of the gap


class ObjectSurface:
    """Samples of a mesh with their normals, in a search tree."""

    def __init__(self, mesh: Mesh) -> None:
        from scipy.spatial import KDTree

        self.points_mm, self.normals = sample_surface(mesh, N_SAMPLES, seed=0)
        self._tree: Any = KDTree(self.points_mm)

    def distances_mm(self, points_mm: ArrayLike, sensor_from_object: Doubles) -> NDArray[np.float32]:
        """Signed distances (n,) of points in the sensor frame, positive outside the object."""
        local = rigid.apply(rigid.invert(sensor_from_object), points_mm)
        gap_mm, nearest = self._tree.query(local)
        signed = ((local - self.points_mm[nearest]) * self.normals[nearest]).sum(axis=-1)
        # Beside an edge the plane of the nearest sample says little: never more than the gap itself, never far less.
        size = np.where(gap_mm > 3 * np.abs(signed) + 0.5, gap_mm, np.abs(signed))
        return np.asarray(np.copysign(size, signed), dtype=np.float32)
