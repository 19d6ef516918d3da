"""Task of touch to depth to touch: what the physical render misses, trained on touches of the
target alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.core.arrays import Floats
from pipeline.core.params import setting
from pipeline.lab.training.denoising import DenoisingTask, TargetSensor
from pipeline.lab.training.object_sampling import DataSplit, find_next_contact
from pipeline.lab.training.target_touches import TargetTouchSample, simulate_target_touch
from pipeline.lab.training.task import VALIDATION_SEED, augmentation_setting
from pipeline.sensors.spec import load_sensor
from pipeline.stages.networks.touch_formats import get_touch_format
from pipeline.stages.touch.t2d2 import build_depth_condition

if TYPE_CHECKING:
    from pipeline.lab.training.task import Example, Split


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchResidualTask(DenoisingTask):
    """Settings of the examples and weights of the loss."""

    target: TargetSensor = setting("soft_bubble", "Target", choices=TargetSensor)
    augmentation_share: float = augmentation_setting()

    @property
    def kind(self) -> str:
        """Kind of the target."""
        return load_sensor(self.target).kind

    def sample(self, rng: np.random.Generator) -> Example:
        """A touch, rotated by 180 degrees or mirrored in a share of the examples."""
        touch = self._get_touch("training", self.press_seed, int(rng.integers(self.n_presses)))
        return flip_example(self._make_example(touch), rng, self.augmentation_share)

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A training object in a new pose, or an unseen tool."""
        return self._make_example(self._get_touch(split, VALIDATION_SEED, index))

    def _get_touch(self, split: DataSplit, seed: int, index: int) -> TargetTouchSample:
        """Touch `index`, or the next one that a source observes."""
        return find_next_contact(
            lambda k: simulate_target_touch(self.target, split, seed, k, self.folder),
            index,
            "no source observes any of",
        )

    def _make_example(self, touch: TargetTouchSample) -> Example:
        condition = build_depth_condition(
            self.kind,
            touch.observed_mm,
            touch.observed,
            touch.in_view,
            touch.physical_mm,
            touch.physical_contact,
        )
        return make_residual_example(
            condition,
            touch.target_mm - touch.physical_mm,
            touch.target_contact,
            touch.physical_contact,
            self.kind,
        )


def flip_example(example: Example, rng: np.random.Generator, share: float) -> Example:
    """The example, with probability `share` rotated by 180 degrees or mirrored."""
    flips = rng.random() < share
    which = int(rng.integers(3))
    if not flips:
        return example
    axes = ((-1,), (-2,), (-2, -1))[which]
    return {name: np.ascontiguousarray(np.flip(a, axes)) for name, a in example.items()}


def make_residual_example(
    condition: Floats, residual_mm: Floats, contact: Any, baseline: Any, kind: str
) -> Example:
    """Condition, residual and contact of a denoiser.

    contact: where the target has contact; baseline: where the physical render has. The residual (2,
    rows, cols) is that of indentation, in units of `TouchFormat.residual_unit_mm`, and that of
    contact.
    """
    true = contact.astype(np.float32)
    physical = baseline.astype(np.float32)
    return {
        "condition": np.ascontiguousarray(condition),
        "residual": np.stack(
            [residual_mm / np.float32(get_touch_format(kind).residual_unit_mm), true - physical]
        ).astype(np.float32),
        "contact": np.stack([true, physical]),
    }
