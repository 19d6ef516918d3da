"""Training task: a controller copies the scripted expert of marble rolling (behaviour cloning).

The expert knows where the ball is. Its demonstrations are what the target sensor records meanwhile;
noise on the motion that is carried out, and not on the expert's command, leads to places that the
network will visit by its own errors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from pipeline.core.arrays import Floats, Image
from pipeline.core.memo import memoise
from pipeline.core.params import setting
from pipeline.lab.tasks.marble import TARGET, command_as_expert, draw_trial, shrink_image
from pipeline.lab.training.task import VALIDATION_SEED, Task

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.lab.training.task import Example, Split

_MAX_BYTES = 2 << 30  # of the demonstrations at hand


@dataclass(frozen=True, slots=True, kw_only=True)
class ClonedPolicyTask(Task):
    """Settings of the demonstrations."""

    n_demonstrations: int = setting(
        160, "Demonstrations", low=1, high=100_000, help="each with another sensor instance"
    )
    n_ticks: int = setting(25, "Ticks", low=1, high=1000, help="of each demonstration")
    noise_mm: float = setting(
        0.5, "Motion noise", unit="mm", low=0.0, high=10.0, help="deviation of the plate's steps"
    )
    demonstration_seed: int = setting(1, "Seed of presses", low=0, high=2**31 - 1)

    def sample(self, rng: np.random.Generator) -> Example:
        """An image of the target and the expert's step."""
        index = int(rng.integers(self.n_demonstrations))
        tick = int(rng.integers(self.n_ticks))
        return self._make_example(self.demonstration_seed, index, tick)

    def make_validation_example(self, split: Split, index: int) -> Example:  # noqa: ARG002 - only new starts
        """A moment of a new demonstration."""
        return self._make_example(VALIDATION_SEED, *divmod(index, self.n_ticks))

    def count_validation_examples(self, split: Split) -> int:
        """There are no unseen objects."""
        return 1 << 30 if split == "unseen_grasps" else 0

    def compute_loss(
        self, network: nn.Module, batch: Mapping[str, Tensor]
    ) -> tuple[Tensor, dict[str, Any]]:
        """Mean distance of the steps, in mm."""
        error = (network(batch["image"]) - batch["step"]).square().sum(1)
        loss = (error + 1e-4).sqrt().mean()
        return loss, {"step error, mm": loss.detach()}

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Distance of the steps from the expert's."""
        import torch

        with torch.inference_mode():
            steps = network(torch.from_numpy(np.stack([one["image"] for one in held_out]))).numpy()
        error = np.linalg.norm(steps - np.stack([one["step"] for one in held_out]), axis=1)
        return {"step error, mm": float(error.mean())}

    def _make_example(self, seed: int, index: int, tick: int) -> Example:
        images, steps = demonstrate(seed, index, self.n_ticks, self.noise_mm)
        return {"image": images[tick], "step": steps[tick]}


@memoise(1 << 16, most_bytes=_MAX_BYTES)
def demonstrate(seed: int, index: int, n_ticks: int, noise_mm: float) -> tuple[Floats, Floats]:
    """Images (n, 3, 48, 64) of the target and the expert's steps (n, 2) in mm of one
    demonstration.
    """
    trial = draw_trial(seed, index, 1.0)
    rng = np.random.default_rng([seed, index])
    ball = trial.start()
    images = []
    steps = []
    for tick in range(n_ticks):
        step = command_as_expert(ball.contact_mm)
        frame, _ = trial.record(TARGET, ball, tick)
        images.append(shrink_image(cast("Image", frame.image)))
        steps.append(step.astype(np.float32))
        ball.move_plate(step + noise_mm * rng.normal(size=2))
    return np.stack(images), np.stack(steps)
