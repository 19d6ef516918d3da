"""Objects to press: the catalogue by name and a user's meshes, with their symmetries."""

from pipeline.core.derived import derive_once
from pipeline.core.errors import SettingProblem
from pipeline.core.geometry.symmetry import Symmetry
from pipeline.physics.simulation.shapes import tasks, training, unseen
from pipeline.physics.simulation.shapes.solids import Shape, load_mesh_shape, make_chamfered_prism

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

GROUPS = ("training", "unseen", "task", "sample")
_MAKERS = {
    "training": training.ALL,
    "unseen": unseen.ALL,
    "task": tasks.ALL,
    "sample": (tasks.notched_elbow,),
}


def list_shapes(group: str = "") -> tuple[str, ...]:
    """Names of the shapes of a group of `GROUPS`, or of all.

    Raises SettingProblem for an unknown group.
    """
    if group and group not in _MAKERS:
        raise SettingProblem(f"unknown group of shapes {group!r}; there are {', '.join(GROUPS)}")
    return tuple(make.__name__ for g in GROUPS if group in ("", g) for make in _MAKERS[g])


def list_labelled_shapes() -> tuple[str, ...]:
    """The objects that networks classify, in the order of their labels: training objects, then
    unseen tools.
    """
    return (*list_shapes("training"), *list_shapes("unseen"))


@derive_once
def make_shape(name: str) -> Shape:
    """The shape of this name, cached; raises SettingProblem for an unknown name."""
    for makers in _MAKERS.values():
        for make in makers:
            if make.__name__ == name:
                return make()
    raise SettingProblem(f"unknown shape {name!r}; there are {', '.join(list_shapes())}")
