"""Touch to touch: the target's touch from the source's reading alone, learned from pairs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.errors import SettingProblem
from pipeline.base.params import setting
from pipeline.sensors import alignment
from pipeline.stages.touch.image_condition import build_image_condition
from pipeline.training.denoising import DenoisingTask, TargetSensor
from pipeline.training.target_touches import DataSplit
from pipeline.training.touch_pairs import TouchPair, mirror_pair, place_nominal_sensors, simulate_touch_pair
from pipeline.training.touch_residual import flip_example, make_residual_example

if TYPE_CHECKING:
    from pipeline.training.task import Example, Split

_HELD_OUT_SEED = 7
_MOST_EMPTY = 100  # pairs in a row that no gel feels
_NOISE_MM, _GRAIN_PX = 0.4, 0.8  # of a bubble's reading, each of the two


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchToTouchTask(DenoisingTask):
    """How examples are made, and what counts for how much."""

    target: TargetSensor = setting(
        "soft_bubble", "Target", choices=TargetSensor, help="the other one of the two is the source"
    )
    n_presses: int = setting(1000, "Presses", low=1, high=10_000_000, help="that all examples are drawn from")
    press_seed: int = setting(1, "Seed of the presses", low=0, high=2**31 - 1)
    folder: str = setting("", "Folder", help="keeps the presses for other runs; empty = worked out each time")
    augmentation_share: float = setting(
        0.5,
        "Share of turned and mirrored examples",
        low=0.0,
        high=1.0,
        help="a quarter of a gel's stay as they were pressed, and are pictured anew",
    )

    def sample(self, rng: np.random.Generator) -> Example:
        """A pair as it is, or turned or mirrored: a gel is pictured anew then, as its light knows left and right."""
        found = self._pair("learned", self.press_seed, int(rng.integers(self.n_presses)))
        if self.kind == "gel":
            return flip_example(self._example(found, rng), rng, self.augmentation_share)
        return self._example(mirror_pair(found, rng) if rng.random() < self.augmentation_share else found, rng)

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A touch of a training object as it was never held, or of one that is never learned from."""
        return self._example(self._pair(split, _HELD_OUT_SEED, index), np.random.default_rng([17, index]))

    def _pair(self, things: DataSplit, seed: int, index: int) -> TouchPair:
        """Pair `index`, or the next one that the gel feels."""
        for k in range(index, index + _MOST_EMPTY):
            found = simulate_touch_pair(things, seed, k, self.folder)
            if found is not None:
                return found
        raise SettingProblem(f"no gel feels any of {_MOST_EMPTY} touches in a row from {index} on; choose another seed")

    def _example(self, touch: TouchPair, rng: np.random.Generator) -> Example:
        gel, bubble = place_nominal_sensors(float(touch.deeper_mm[0]))
        if self.kind == "bubble":
            change = touch.change_grey + rng.normal(0.0, 1.0, touch.change_grey.shape).astype(np.float32)
            shown = build_image_condition(change, gel.camera, gel, bubble, alignment.resolve_alignment(gel, bubble))
            truth, contact = touch.bubble_mm, touch.bubble_contact
        else:
            change = touch.bubble_mm + _reading_noise(rng, touch.bubble_mm.shape)
            shown = build_image_condition(change, bubble.camera, bubble, gel, alignment.resolve_alignment(bubble, gel))
            truth, contact = touch.gel_mm, touch.gel_contact
        return make_residual_example(shown, truth, contact, np.zeros(contact.shape, np.bool_), self.kind)


def _reading_noise(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Of the difference of two readings of a depth camera."""
    import cv2

    white = rng.standard_normal(shape).astype(np.float32)
    grains = np.asarray(cv2.GaussianBlur(white, (0, 0), _GRAIN_PX), np.float32)
    return grains * np.float32(np.sqrt(2.0) * _NOISE_MM * rng.uniform(0.7, 1.2) / grains.std())
