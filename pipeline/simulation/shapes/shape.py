"""What an object to press is."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.geometry.meshes import Mesh
from pipeline.geometry.symmetry import Symmetry


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """An object to press: one mesh, from which the simulator's contact and the registration's model both come."""

    mesh: Mesh  # its own frame: z away from the sensor, the tactile face is the side of least z
    symmetry: Symmetry
