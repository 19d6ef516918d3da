"""Every object by its name."""

from __future__ import annotations

from functools import lru_cache

from pipeline.base.errors import SettingProblem
from pipeline.simulation.shapes import tasks, training, unseen
from pipeline.simulation.shapes.shape import Shape

GROUPS = ("training", "unseen", "task", "sample")
_MAKERS = {
    "training": training.ALL,
    "unseen": unseen.ALL,
    "task": tasks.ALL,
    "sample": (tasks.notched_elbow,),
}


def list_shapes(group: str = "") -> tuple[str, ...]:
    """The names of a group of "training", "unseen", "task" and "sample", or of all; SettingProblem if unknown."""
    if group and group not in _MAKERS:
        raise SettingProblem(f"unknown group of shapes {group!r}; there are {', '.join(GROUPS)}")
    return tuple(make.__name__ for g in GROUPS if group in ("", g) for make in _MAKERS[g])


def list_labelled_shapes() -> tuple[str, ...]:
    """What networks know by name, in the order of their labels: all that is trained on, and the unseen tools."""
    return (*list_shapes("training"), *list_shapes("unseen"))


@lru_cache(maxsize=64)
def make_shape(name: str) -> Shape:
    """The shape of this name; made once. Raises SettingProblem, naming all, when there is none."""
    for makers in _MAKERS.values():
        for make in makers:
            if make.__name__ == name:
                return make()
    raise SettingProblem(f"unknown shape {name!r}; there are {', '.join(list_shapes())}")
