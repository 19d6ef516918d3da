"""An object to press."""

from dataclasses import dataclass

from pipeline.geometry.meshes import Mesh
from pipeline.geometry.symmetry import Symmetry


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """Mesh and symmetry of an object; simulation and registration use the same mesh."""

    mesh: Mesh  # object frame: z away from the sensor, tactile face at the lowest z
    symmetry: Symmetry
