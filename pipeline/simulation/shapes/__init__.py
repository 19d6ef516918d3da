"""Objects to press: the catalogue, a user's own meshes, and what maps each onto itself."""

from pipeline.geometry.symmetry import Symmetry
from pipeline.simulation.shapes.catalogue import GROUPS, names, shape, taught
from pipeline.simulation.shapes.own import from_mesh
from pipeline.simulation.shapes.prisms import bar
from pipeline.simulation.shapes.shape import Shape

__all__ = ["GROUPS", "Shape", "Symmetry", "bar", "from_mesh", "names", "shape", "taught"]
