"""Touch to depth to touch: what the target's physical render misses, learned from the target's own touches alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.errors import SettingProblem
from pipeline.base.params import setting
from pipeline.sensors.spec import sensor
from pipeline.stages.generate.residual_input import of_view
from pipeline.training import denoising
from pipeline.training.own_touches import Taught, Things, own_touch

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.task import Example, Split

Target = Literal["soft_bubble", "gelslim"]
UNITS_MM = {"bubble": 3.0, "gel": 0.2}  # of the residual: about its standard deviation where it is large
_HELD_OUT_SEED = 7
_MOST_EMPTY = 100  # touches in a row of which nothing is told


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualOfView:
    """How examples are made, and what counts for how much."""

    target: Target = setting("soft_bubble", "Target", choices=Target)
    presses: int = setting(2000, "Presses", low=1, high=10_000_000, help="that all examples are drawn from")
    press_seed: int = setting(1, "Seed of the presses", low=0, high=2**31 - 1)
    folder: str = setting("", "Folder", help="keeps the presses for other runs; empty = worked out each time")
    near: float = setting(1.0, "Weight of the contact", low=0.0, high=100.0)
    slopes: float = setting(0.0, "Weight of the slopes", low=0.0, high=1000.0, help="of what a gel's picture shows")
    turned: float = setting(0.5, "Share of turned and mirrored examples", low=0.0, high=1.0)

    def sample(self, rng: np.random.Generator) -> Example:
        """A touch as it is or, half the time, turned by 180 degrees or mirrored."""
        found = self._example(self._touch("learned", self.press_seed, int(rng.integers(self.presses))))
        return turned(found, rng, self.turned)

    def held_out(self, split: Split, index: int) -> Example:
        """A touch of a training object as it was never held, or of one that is never learned from."""
        return self._example(self._touch(split, _HELD_OUT_SEED, index))

    def loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """See `denoising.loss`."""
        return denoising.loss(network, batch, self.near, self.slopes)

    def figures(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """See `denoising.figures`."""
        return denoising.figures(network, held_out, UNITS_MM[self._kind])

    @property
    def _kind(self) -> str:
        return sensor(self.target).kind

    def _touch(self, things: Things, seed: int, index: int) -> Taught:
        """Touch `index`, or the next of which something is told."""
        for k in range(index, index + _MOST_EMPTY):
            found = own_touch(self.target, things, seed, k, self.folder)
            if found is not None:
                return found
        raise SettingProblem(f"nothing is told of {_MOST_EMPTY} touches in a row from {index} on; choose another seed")

    def _example(self, touch: Taught) -> Example:
        shown = of_view(
            self._kind, touch.told_mm, touch.felt, touch.known, touch.physical_mm, touch.physical_contact
        )  # fmt: skip
        return example(shown, touch.truth_mm - touch.physical_mm, touch.contact, touch.physical_contact, self._kind)


def turned(found: Example, rng: np.random.Generator, share: float) -> Example:
    """An example, a share of all times turned by 180 degrees or mirrored."""
    turns, way = rng.random() < share, int(rng.integers(3))
    if not turns:
        return found
    axes = ((-1,), (-2,), (-2, -1))[way]
    return {name: np.ascontiguousarray(np.flip(a, axes)) for name, a in found.items()}


def example(shown: Floats, residual_mm: Floats, contact: Any, base: Any, kind: str) -> Example:
    """What a denoiser is shown, the residual that it is to find, and where the target touches and was said to."""
    touched, said = contact.astype(np.float32), base.astype(np.float32)
    return {
        "condition": np.ascontiguousarray(shown),
        "residual": np.stack([residual_mm / np.float32(UNITS_MM[kind]), touched - said]).astype(np.float32),
        "contact": np.stack([touched, said]),
    }
