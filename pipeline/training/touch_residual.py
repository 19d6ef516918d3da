"""Touch to depth to touch: what the target's physical render misses, learned from the target's own touches alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.errors import SettingProblem
from pipeline.base.params import setting
from pipeline.stages.touch.depth_condition import build_depth_condition
from pipeline.training.denoising import RESIDUAL_SCALE_MM, DenoisingTask
from pipeline.training.target_touches import DataSplit, TargetTouchSample, simulate_target_touch

if TYPE_CHECKING:
    from pipeline.training.task import Example, Split

_HELD_OUT_SEED = 7
_MOST_EMPTY = 100  # touches in a row of which nothing is told


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchResidualTask(DenoisingTask):
    """How examples are made, and what counts for how much."""

    n_presses: int = setting(2000, "Presses", low=1, high=10_000_000, help="that all examples are drawn from")
    press_seed: int = setting(1, "Seed of the presses", low=0, high=2**31 - 1)
    folder: str = setting("", "Folder", help="keeps the presses for other runs; empty = worked out each time")
    augmentation_share: float = setting(0.5, "Share of turned and mirrored examples", low=0.0, high=1.0)

    def sample(self, rng: np.random.Generator) -> Example:
        """A touch as it is or, half the time, turned by 180 degrees or mirrored."""
        found = self._example(self._touch("learned", self.press_seed, int(rng.integers(self.n_presses))))
        return flip_example(found, rng, self.augmentation_share)

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A touch of a training object as it was never held, or of one that is never learned from."""
        return self._example(self._touch(split, _HELD_OUT_SEED, index))

    def _touch(self, things: DataSplit, seed: int, index: int) -> TargetTouchSample:
        """Touch `index`, or the next of which something is told."""
        for k in range(index, index + _MOST_EMPTY):
            found = simulate_target_touch(self.target, things, seed, k, self.folder)
            if found is not None:
                return found
        raise SettingProblem(f"nothing is told of {_MOST_EMPTY} touches in a row from {index} on; choose another seed")

    def _example(self, touch: TargetTouchSample) -> Example:
        shown = build_depth_condition(
            self.kind, touch.observed_mm, touch.observed, touch.in_view, touch.physical_mm, touch.physical_contact
        )  # fmt: skip
        return make_residual_example(
            shown, touch.target_mm - touch.physical_mm, touch.target_contact, touch.physical_contact, self.kind
        )


def flip_example(found: Example, rng: np.random.Generator, share: float) -> Example:
    """An example, a share of all times turned by 180 degrees or mirrored."""
    turns, way = rng.random() < share, int(rng.integers(3))
    if not turns:
        return found
    axes = ((-1,), (-2,), (-2, -1))[way]
    return {name: np.ascontiguousarray(np.flip(a, axes)) for name, a in found.items()}


def make_residual_example(shown: Floats, residual_mm: Floats, contact: Any, base: Any, kind: str) -> Example:
    """What a denoiser is shown, the residual that it is to find, and where the target touches and was said to."""
    touched, said = contact.astype(np.float32), base.astype(np.float32)
    return {
        "condition": np.ascontiguousarray(shown),
        "residual": np.stack([residual_mm / np.float32(RESIDUAL_SCALE_MM[kind]), touched - said]).astype(np.float32),
        "contact": np.stack([touched, said]),
    }
