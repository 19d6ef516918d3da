"""Touch to depth to touch: what the target's physical render misses, learned from the target's own touches alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.errors import SettingProblem
from pipeline.base.params import setting
from pipeline.stages.generate.residual_input import of_view
from pipeline.training.denoising import UNITS_MM, Denoising
from pipeline.training.own_touches import Taught, Things, own_touch

if TYPE_CHECKING:
    from pipeline.training.task import Example, Split

_HELD_OUT_SEED = 7
_MOST_EMPTY = 100  # touches in a row of which nothing is told


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualOfView(Denoising):
    """How examples are made, and what counts for how much."""

    presses: int = setting(2000, "Presses", low=1, high=10_000_000, help="that all examples are drawn from")
    press_seed: int = setting(1, "Seed of the presses", low=0, high=2**31 - 1)
    folder: str = setting("", "Folder", help="keeps the presses for other runs; empty = worked out each time")
    turned: float = setting(0.5, "Share of turned and mirrored examples", low=0.0, high=1.0)

    def sample(self, rng: np.random.Generator) -> Example:
        """A touch as it is or, half the time, turned by 180 degrees or mirrored."""
        found = self._example(self._touch("learned", self.press_seed, int(rng.integers(self.presses))))
        return turned(found, rng, self.turned)

    def held_out(self, split: Split, index: int) -> Example:
        """A touch of a training object as it was never held, or of one that is never learned from."""
        return self._example(self._touch(split, _HELD_OUT_SEED, index))

    def _touch(self, things: Things, seed: int, index: int) -> Taught:
        """Touch `index`, or the next of which something is told."""
        for k in range(index, index + _MOST_EMPTY):
            found = own_touch(self.target, things, seed, k, self.folder)
            if found is not None:
                return found
        raise SettingProblem(f"nothing is told of {_MOST_EMPTY} touches in a row from {index} on; choose another seed")

    def _example(self, touch: Taught) -> Example:
        shown = of_view(
            self.kind, touch.told_mm, touch.felt, touch.known, touch.physical_mm, touch.physical_contact
        )  # fmt: skip
        return example(shown, touch.truth_mm - touch.physical_mm, touch.contact, touch.physical_contact, self.kind)


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
