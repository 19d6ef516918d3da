"""Task of touch to touch: fine-tune weights of simulated pairs on a few recorded pairs.

The first pairs of a recording of both sensors are trained on, the others validate. Each example is a pair that is
moved, rotated and brightened a little.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.base.arrays import Floats, freeze
from pipeline.base.params import setting
from pipeline.inspection.synchrony import compare_signatures, compute_signature
from pipeline.training.denoising import DenoisingTask
from pipeline.training.recorded_pairs import RecordedPairs, TrainingPair, load_recorded_pairs
from pipeline.training.touch_residual import make_residual_example

if TYPE_CHECKING:
    from pipeline.training.task import Example, Split

_MAX_ROTATION_DEG, _MAX_SCALING, _MAX_TRANSLATION = 5.0, 0.05, 0.03  # the last in shares of the image's rows
_MAX_BRIGHTENING = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class PairFineTuningTask(DenoisingTask):
    """Settings of the pairs and weights of the loss; the sensor that is not the target is the source."""

    recording: str = setting("", "Recording", help="of both sensors")
    n_pairs: int = setting(10, "Pairs", low=1, high=1_000_000, help="trained on, from the first")

    def sample(self, rng: np.random.Generator) -> Example:
        """One of the training pairs, jittered."""
        return self._make_example(jitter_pair(self._load().pairs[int(rng.integers(self._n_training))], rng))

    def make_validation_example(self, split: Split, index: int) -> Example:  # noqa: ARG002 - recorded pairs have no splits
        """One of the other pairs; a training pair where there are no others."""
        pairs = self._load().pairs
        rest = pairs[self._n_training :] or pairs
        return self._make_example(rest[index % len(rest)])

    @property
    def _n_training(self) -> int:
        return min(self.n_pairs, len(self._load().pairs))

    def collect_notes(self) -> tuple[str, ...]:
        """Open the recording; warnings about its pairs."""
        n, recorded = self._n_training, self._load()
        pairs = recorded.pairs
        order = compare_signatures(
            [compute_signature(np.abs(pair.condition[:-1]).sum(axis=0)) for pair in pairs],
            [compute_signature(pair.indentation_mm) for pair in pairs],
        )
        warnings = () if order is None or order.warning is None else (order.warning,)
        if n < len(pairs):
            return (*warnings, *recorded.notes)
        asked = f" ({self.n_pairs} requested)" if self.n_pairs > n else ""
        none_left = (
            f"all {n} pairs are trained on{asked}, none is left for validation: its figures are of training pairs"
        )
        return (*warnings, *recorded.notes, none_left)

    def _load(self) -> RecordedPairs:
        source = "gelslim" if self.kind == "bubble" else "soft_bubble"
        return load_recorded_pairs(self.recording, source, self.target)

    def _make_example(self, pair: TrainingPair) -> Example:
        no_contact = np.zeros(pair.contact.shape, np.bool_)
        return make_residual_example(pair.condition, pair.indentation_mm, pair.contact, no_contact, self.kind)


def jitter_pair(pair: TrainingPair, rng: np.random.Generator) -> TrainingPair:
    """The pair slightly rotated, scaled and translated, its source's change stronger or weaker."""
    import cv2

    rows, cols = pair.contact.shape
    angle = math.radians(rng.uniform(-_MAX_ROTATION_DEG, _MAX_ROTATION_DEG))
    scale = 1.0 + rng.uniform(-_MAX_SCALING, _MAX_SCALING)
    across, down = rng.uniform(-_MAX_TRANSLATION, _MAX_TRANSLATION, 2) * rows
    cos, sin = scale * math.cos(angle), scale * math.sin(angle)
    x, y = (cols - 1) / 2, (rows - 1) / 2
    matrix = np.array([[cos, -sin, x - cos * x + sin * y + across], [sin, cos, y - sin * x - cos * y + down]])

    def warp(field: Any) -> Floats:
        return np.asarray(cv2.warpAffine(np.asarray(field, np.float32), matrix, (cols, rows), flags=cv2.INTER_LINEAR,
                                         borderMode=cv2.BORDER_REPLICATE), np.float32)  # fmt: skip

    condition = np.stack([warp(channel) for channel in pair.condition])
    condition[:-1] *= np.float32(1.0 + rng.uniform(-_MAX_BRIGHTENING, _MAX_BRIGHTENING))  # the last channel is a mask
    return TrainingPair(
        condition=freeze(condition),
        indentation_mm=freeze(warp(pair.indentation_mm)),
        contact=freeze(warp(pair.contact) > 0.5),
    )
