"""A user's mesh file as an object to press."""

from pathlib import Path

import numpy as np

from pipeline.base.errors import SettingProblem
from pipeline.geometry.meshes import load_mesh
from pipeline.geometry.symmetry import asymmetric
from pipeline.simulation.shapes.shape import Shape
from pipeline.simulation.shapes.solids import transform_mesh

FACES = ("-x", "+x", "-y", "+y", "-z", "+z")


def load_mesh_shape(path: Path, unit: str = "auto", face: str = "-z") -> Shape:
    """A shape from an STL, PLY or OBJ file, its tactile side toward `face`; without symmetry.

    That side is rotated to -z, and the mesh centred over the origin with its lowest point at z = 0.
    Raises SettingProblem for an unknown face, FileProblem or MeshProblem for what `load_mesh` refuses.
    """
    if face not in FACES:
        raise SettingProblem(f"the tactile face must be one of {', '.join(FACES)}, got {face!r}")
    mesh = transform_mesh(load_mesh(Path(path), unit), _rotate_down(face))
    low, high = mesh.vertices_mm.min(axis=0), mesh.vertices_mm.max(axis=0)
    place = np.eye(4)
    place[:3, 3] = (*(-0.5 * (low + high)[:2]), -low[2])
    mesh = transform_mesh(mesh, place)
    return Shape(mesh=mesh, symmetry=asymmetric())


def _rotate_down(face: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """The rotation (4, 4) that takes an axis to -z."""
    axis = "xyz".index(face[1])
    down = np.zeros(3)
    down[axis] = 1.0 if face[0] == "+" else -1.0
    side = np.zeros(3)
    side[(axis + 1) % 3] = 1.0
    turn = np.eye(4)
    turn[:3, :3] = np.stack([np.cross(side, -down), side, -down])  # rows are x, y, z; right-handed: x = y cross z
    return turn
