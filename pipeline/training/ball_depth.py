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
from pipeline.training import gel_readings
from pipeline.training.gel_depth import Example, GelDepth, example, moved
from pipeline.training.gel_readings import Taught
from pipeline.training.task import Split

if TYPE_CHECKING:
    from torch import Tensor, nn


@dataclass(frozen=True, slots=True, kw_only=True)
class BallDepth:
    """What is learned from; the presses travel beside the settings, which know them by their content."""

    content: str = setting("", "Digest of the presses")
    share: float = setting(1.0, "Share of the unit's own presses", low=0.0, high=1.0)
    pictures: int = setting(24, "Simulated pictures", low=1, high=10_000)
    folder: str = ""  # that keeps them
    learned: tuple[Taught, ...] = ()
    held: tuple[Taught, ...] = ()

    def sample(self, rng: np.random.Generator) -> Example:
        """A part of one of the presses, or of a simulated picture."""
        if rng.random() < self.share:
            return moved(rng, self.learned[int(rng.integers(len(self.learned)))])
        return GelDepth(presses=self.pictures, pictures=self.pictures, folder=self.folder).sample(rng)

    def held_out(self, split: Split, index: int) -> Example:
        """Presses of the unit that training does not see, and simulated tools."""
        return example(gel_readings.tool(index) if split == "unseen_tools" else self.held[index % len(self.held)])

    def loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """That of all gels."""
        return GelDepth().loss(network, batch)

    def figures(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Those of all gels."""
        return GelDepth().figures(network, held_out)
