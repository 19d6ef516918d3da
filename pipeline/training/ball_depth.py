"""To correct what the look-up of one unit reads: presses of a ball on it, among simulated touches.

Balls alone would be all that the network knows in the end; simulated touches of other units, as it has learned them
before, keep the rest. Loads no torch when it is imported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.base.params import setting
from pipeline.training import gel_samples
from pipeline.training.gel_depth import Example, GelDepthTask, crop_around_contact, make_example
from pipeline.training.gel_samples import GelTrainingSample
from pipeline.training.task import Split

if TYPE_CHECKING:
    from torch import Tensor, nn


@dataclass(frozen=True, slots=True, kw_only=True)
class BallDepthTask:
    """What is learned from; the presses travel beside the settings, which know them by their content."""

    content_digest: str = setting("", "Digest of the presses")
    press_share: float = setting(1.0, "Share of the unit's own presses", low=0.0, high=1.0)
    n_images: int = setting(24, "Simulated pictures", low=1, high=10_000)
    folder: str = ""  # that keeps them
    training_samples: tuple[GelTrainingSample, ...] = ()
    validation_samples: tuple[GelTrainingSample, ...] = ()

    def sample(self, rng: np.random.Generator) -> Example:
        """A part of one of the presses, or of a simulated picture."""
        if rng.random() < self.press_share:
            return crop_around_contact(rng, self.training_samples[int(rng.integers(len(self.training_samples)))])
        return GelDepthTask(n_presses=self.n_images, n_images=self.n_images, folder=self.folder).sample(rng)

    def make_validation_example(self, split: Split, index: int) -> Example:
        """Presses of the unit that training does not see, and simulated tools."""
        return make_example(
            gel_samples.simulate_unseen_tool(index)
            if split == "unseen_tools"
            else self.validation_samples[index % len(self.validation_samples)]
        )

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """That of all gels."""
        return GelDepthTask().compute_loss(network, batch)

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Those of all gels."""
        return GelDepthTask().evaluate(network, held_out)
