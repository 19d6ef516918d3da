"""What is learned: a task gives examples, a loss and figures; it is one module and one line of `TASKS`.

Loads neither torch nor numpy: the command line reads the table to say what can be trained.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol, runtime_checkable

from pipeline.base.errors import SettingProblem

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from torch import Tensor, nn

    Example = dict[str, NDArray[Any]]

Split = Literal["unseen_grasps", "unseen_tools"]
SPLITS: tuple[Split, ...] = ("unseen_grasps", "unseen_tools")


class Task(Protocol):
    """A frozen dataclass whose fields are `pipeline.base.params.setting`s: what a recipe may say under [settings].

    It travels to worker processes, which make the examples: its module loads no torch when it is imported.
    """

    def sample(self, rng: np.random.Generator) -> Example:
        """One example drawn with `rng` alone: arrays of equal shape every time, channels first, uint8 or float32."""
        ...

    def held_out(self, split: Split, index: int) -> Example:
        """Example `index` of those that training never sees; the same each time it is asked for."""
        ...

    def loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """The loss, a mean over the examples, and its parts by name (numbers or tensors of one number).

        `network` is called, `network(x)`, never reached into: it may be one of several that learn together. What it
        was built with is told by `devices.bare`. What it answers is float32 whatever it computes in.
        """
        ...

    def figures(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """How good it is on held-out examples: name with its unit -> number, such as "error in contact, um"."""
        ...


@runtime_checkable
class Noted(Protocol):
    """What a task has, too, that learns from what somebody recorded."""

    def notes(self) -> tuple[str, ...]:
        """What was assumed of it or left out; asked for, and with it opened, before the training begins."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One line of the table."""

    what: str  # `tactoscope train WHAT`
    where: str  # module:class


TASKS: dict[str, Entry] = {
    "gel_depth": Entry(what="depth", where="pipeline.training.gel_depth:GelDepth"),
    "gel_units": Entry(what="depth", where="pipeline.training.gel_units:GelUnits"),
    "depth_anything": Entry(what="depth", where="pipeline.training.depth_anything:DepthAnythingTask"),
    "vqvae": Entry(what="vqvae", where="pipeline.training.vqvae:VqVaeTask"),
    "latent": Entry(what="latent", where="pipeline.training.latent:LatentTask"),
    "touch_pose": Entry(what="pose", where="pipeline.training.touch_pose:TouchPoseTask"),
    "bubble_reading": Entry(what="depth", where="pipeline.training.bubble_reading:BubbleReading"),
    "residual_of_view": Entry(what="t2d2", where="pipeline.training.residual:ResidualOfView"),
    "touch_to_touch": Entry(what="t2t", where="pipeline.training.touch_to_touch:TouchToTouch"),
    "kept_pairs": Entry(what="t2t", where="pipeline.training.kept_pairs:KeptPairs"),
}


def task_class(name: str) -> type[Any]:
    """The class of a task; raises SettingProblem for one that does not exist."""
    if name not in TASKS:
        raise SettingProblem(f"no task {name!r}; there are {', '.join(TASKS)}")
    module, _, wanted = TASKS[name].where.partition(":")
    return getattr(importlib.import_module(module), wanted)
