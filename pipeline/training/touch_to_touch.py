"""Task of touch to touch: the target's touch from the source's frame, trained on simulated pairs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.sensors import alignment
from pipeline.stages.touch.image_condition import build_image_condition
from pipeline.training.conditioned_touch import ConditionedTouch, condition_recorded_pair, jitter_touch
from pipeline.training.denoising import DenoisingTask
from pipeline.training.object_sampling import DataSplit, find_next_contact
from pipeline.training.recorded_pairs import RecordedPair
from pipeline.training.task import VALIDATION_SEED, augmentation_setting
from pipeline.training.touch_pairs import (
    BUBBLE,
    GEL,
    TouchPair,
    mirror_pair,
    place_nominal_sensors,
    simulate_touch_pair,
)
from pipeline.training.touch_residual import make_residual_example

if TYPE_CHECKING:
    from pipeline.training.task import Example, Split


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchToTouchTask(DenoisingTask):
    """Settings of the examples and weights of the loss; from a gel to a bubble."""

    augmentation_share: float = augmentation_setting(
        help="mirrored examples, three in four of them with a new image"
    )

    @property
    def kind(self) -> str:
        """Kind of the target."""
        return "bubble"

    def sample(self, rng: np.random.Generator) -> Example:
        """A pair, augmented in a share of the examples; a gel's image is rendered anew, as its LEDs are asymmetric."""
        pair = self._get_pair("training", self.press_seed, int(rng.integers(self.n_presses)))
        return self._make_example(mirror_pair(pair, rng) if rng.random() < self.augmentation_share else pair, rng)

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A training object in a new pose, or an unseen tool."""
        return self._make_example(self._get_pair(split, VALIDATION_SEED, index), np.random.default_rng([17, index]))

    @property
    def pair_sensors(self) -> tuple[str, str]:
        """Names of source and target."""
        return GEL, BUBBLE

    def prepare_pair(self, pair: RecordedPair) -> ConditionedTouch | None:
        """Condition and true touch of a recorded pair."""
        return condition_recorded_pair(pair)

    def make_pair_example(
        self, prepared: ConditionedTouch, rng: np.random.Generator, *, is_validation: bool
    ) -> Example:
        """A recorded pair, moved, rotated and brightened a little unless it validates."""
        touch = prepared if is_validation else jitter_touch(prepared, rng)
        no_contact = np.zeros(touch.contact.shape, np.bool_)
        return make_residual_example(touch.condition, touch.indentation_mm, touch.contact, no_contact, self.kind)

    def _get_pair(self, split: DataSplit, seed: int, index: int) -> TouchPair:
        """Pair `index`, or the next one with contact on the gel."""
        return find_next_contact(
            lambda k: simulate_touch_pair(split, seed, k, self.folder), index, "the gel has no contact in"
        )

    def _make_example(self, pair: TouchPair, rng: np.random.Generator) -> Example:
        gel, bubble = place_nominal_sensors(float(pair.deeper_mm[0]))
        change = pair.change_grey + rng.normal(0.0, 1.0, pair.change_grey.shape).astype(np.float32)
        between = alignment.resolve_alignment(gel, bubble)
        condition = build_image_condition(change, gel.camera, gel, bubble, between)
        no_contact = np.zeros(pair.bubble_contact.shape, np.bool_)
        return make_residual_example(condition, pair.bubble_mm, pair.bubble_contact, no_contact, self.kind)
