"""Objects to press: the catalogue and a user's meshes, with their symmetries."""

from pipeline.geometry.symmetry import Symmetry
from pipeline.simulation.shapes.catalogue import GROUPS, list_labelled_shapes, list_shapes, make_shape
from pipeline.simulation.shapes.prisms import make_chamfered_prism
from pipeline.simulation.shapes.solids import Shape, load_mesh_shape

__all__ = [
    "GROUPS",
    "Shape",
    "Symmetry",
    "list_labelled_shapes",
    "list_shapes",
    "load_mesh_shape",
    "make_chamfered_prism",
    "make_shape",
]
