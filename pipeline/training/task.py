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

    def make_validation_example(self, split: Split, index: int) -> Example:
        """Example `index` of those that training never sees; the same each time it is asked for."""
        ...

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """The loss, a mean over the examples, and its parts by name (numbers or tensors of one number).

        `network` is called, `network(x)`, never reached into: it may be one of several that learn together. What it
        was built with is told by `devices.bare`. What it answers is float32 whatever it computes in.
        """
        ...

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """How good it is on held-out examples: name with its unit -> number, such as "error in contact, um"."""
        ...


@runtime_checkable
class HasNotes(Protocol):
    """What a task has, too, that learns from what somebody recorded."""

    def collect_notes(self) -> tuple[str, ...]:
        """What was assumed of it or left out; asked for, and with it opened, before the training begins."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskEntry:
    """One line of the table."""

    subcommand: str  # `tactoscope train WHAT`
    import_path: str  # module:class


TASKS: dict[str, TaskEntry] = {
    "gel_instances": TaskEntry(subcommand="depth", import_path="pipeline.training.gel_instances:GelInstancesTask"),
    "depth_anything": TaskEntry(subcommand="depth", import_path="pipeline.training.depth_anything:DepthAnythingTask"),
    "vqvae": TaskEntry(subcommand="vqvae", import_path="pipeline.training.vqvae:VqVaeTask"),
    "latent": TaskEntry(subcommand="latent", import_path="pipeline.training.latent:LatentTask"),
    "touch_pose": TaskEntry(subcommand="pose", import_path="pipeline.training.touch_pose:TouchPoseTask"),
    "bubble_depth": TaskEntry(subcommand="depth", import_path="pipeline.training.bubble_depth:BubbleDepthTask"),
    "touch_residual": TaskEntry(subcommand="t2d2", import_path="pipeline.training.touch_residual:TouchResidualTask"),
    "touch_to_touch": TaskEntry(subcommand="t2t", import_path="pipeline.training.touch_to_touch:TouchToTouchTask"),
    "pair_fine_tuning": TaskEntry(
        subcommand="t2t", import_path="pipeline.training.pair_fine_tuning:PairFineTuningTask"
    ),
}


def import_task_class(name: str) -> type[Any]:
    """The class of a task; raises SettingProblem for one that does not exist."""
    if name not in TASKS:
        raise SettingProblem(f"no task {name!r}; there are {', '.join(TASKS)}")
    module, _, wanted = TASKS[name].import_path.partition(":")
    return getattr(importlib.import_module(module), wanted)
