"""Objects to press: the catalogue, a user's own meshes, and what maps each onto itself."""

from pipeline.physics.shapes.catalogue import GROUPS, names, shape
from pipeline.physics.shapes.own import from_mesh
from pipeline.physics.shapes.prisms import bar
from pipeline.physics.shapes.shape import Shape
from pipeline.physics.shapes.symmetry import Symmetry

__all__ = ["GROUPS", "Shape", "Symmetry", "bar", "from_mesh", "names", "shape"]
