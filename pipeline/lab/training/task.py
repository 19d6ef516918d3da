"""Tasks that can be trained: each gives examples, a loss and metrics, is one module and one line of
`TASKS`.

Loads neither torch nor numpy: the command line reads the table to list what can be trained.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, Protocol

from pipeline.core.entry_points import load_reference
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.params import setting

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from torch import Tensor, nn

    Example = dict[str, NDArray[Any]]

Split = Literal["unseen_grasps", "unseen_tools"]
SPLITS: tuple[Split, ...] = ("unseen_grasps", "unseen_tools")
TargetSensor = Literal["soft_bubble", "gelslim"]
VALIDATION_SEED = 7  # of presses for validation; recipes train with press_seed 1


class Task(Protocol):
    """A frozen dataclass whose fields are `pipeline.core.params.setting`s: the [settings] of a
    recipe.

    Worker processes receive it to make examples, so its module loads no torch on import. A task
    that also trains on recorded pairs has `pair_sensors`, the names of source and target, and
    `prepare_pair(pair)`, which is cached, None where the pair cannot be used.
    """

    __slots__ = ()

    def sample(self, rng: np.random.Generator) -> Example:
        """One training example; `rng` is its only randomness.

        Arrays have the same shapes every time, channels first, uint8 or float32.
        """
        ...

    def make_validation_example(self, split: Split, index: int) -> Example:
        """Validation example `index`; the same on every call, and never trained on."""
        ...

    def count_validation_examples(self, split: Split) -> int:  # noqa: ARG002
        """Number of validation examples of a split; 0 = none."""
        return 1 << 30

    def make_pair_example(
        self,
        prepared: Example,
        rng: np.random.Generator,  # noqa: ARG002
        *,
        is_validation: bool,  # noqa: ARG002
    ) -> Example:
        """The example of a recorded pair; augmented unless it validates."""
        return prepared

    def collect_notes(self) -> tuple[str, ...]:
        """What was assumed or left out of recordings; called before training starts."""
        return ()

    def compute_loss(
        self, network: nn.Module, batch: Mapping[str, Tensor]
    ) -> tuple[Tensor, dict[str, Any]]:
        """The loss, a mean over the examples, and its named terms (numbers or scalar tensors).

        `network` is only called: it may be wrapped for several processes.
        `distributed.unwrap_network` gives its configuration. Its output is float32 in any
        precision.
        """
        ...

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Metrics on validation examples: name with unit -> value, such as "error in contact,
        um".
        """
        ...


@frozen
class TaskEntry:
    """One line of the table."""

    subcommand: str  # of `tactoscope train`
    import_path: str  # module:class


TASKS: dict[str, TaskEntry] = {
    "depth_anything": TaskEntry(
        subcommand="depth", import_path="pipeline.lab.training.depth_anything:DepthAnythingTask"
    ),
    "vqvae": TaskEntry(
        subcommand="vqvae", import_path="pipeline.lab.training.square_tasks:VqVaeTask"
    ),
    "latent": TaskEntry(
        subcommand="latent", import_path="pipeline.lab.training.square_tasks:LatentTask"
    ),
    "touch_pose": TaskEntry(
        subcommand="pose", import_path="pipeline.lab.training.touch_pose:TouchPoseTask"
    ),
    "bubble_depth": TaskEntry(
        subcommand="depth", import_path="pipeline.lab.training.bubble_depth:BubbleDepthTask"
    ),
    "touch_residual": TaskEntry(
        subcommand="t2d2", import_path="pipeline.lab.training.denoising:TouchResidualTask"
    ),
    "cloned_policy": TaskEntry(
        subcommand="policy", import_path="pipeline.lab.tasks.marble:ClonedPolicyTask"
    ),
    "touch_to_touch": TaskEntry(
        subcommand="t2t", import_path="pipeline.lab.training.denoising:TouchToTouchTask"
    ),
}


def weigh_terms(terms: Mapping[str, tuple[float, Tensor]]) -> tuple[Tensor, dict[str, Tensor]]:
    """The loss, a weighted sum, and its terms; `terms` are name -> (weight, term)."""
    loss: Any = sum(weight * term for weight, term in terms.values())
    return loss, {name: term.detach() for name, (_, term) in terms.items()}


def average_rows(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Name -> mean of its column; a row for each validation example."""
    return {name: sum(float(row[name]) for row in rows) / len(rows) for name in rows[0]}


def import_task_class(name: str) -> type[Any]:
    """The class of a task; raises SettingProblem for an unknown name."""
    if name not in TASKS:
        raise SettingProblem(f"no task {name!r}; there are {', '.join(TASKS)}")
    return load_reference(TASKS[name].import_path)


@frozen
class SimulatedPresses(Task):
    """Settings of a task whose examples are drawn from a number of presses."""

    press_seed: int = setting(1, "Seed of presses", low=0, high=2**31 - 1)
    folder: str = setting(
        "", "Folder", help="stores simulated presses for other runs; empty = simulated in every run"
    )
    n_presses: int = setting(
        2000,
        "Presses",
        low=1,
        high=10_000_000,
        help="simulated presses that all examples are drawn from",
    )


@frozen
class AugmentedPresses(SimulatedPresses):
    """Presses that are also shown rotated or mirrored."""

    augmentation_share: float = setting(
        0.5, "Augmentation share", low=0.0, high=1.0, help="rotated or mirrored examples"
    )
