"""A few pairs that were really recorded, drawn beforehand: what weights of simulated pairs are taught on with.

A recording of both sensors holds them, or a folder by number (`draw`), each on the target's own grid: the first ones
are learned from, all others are held out. Of so few, every one is moved, turned and brightened a little each time that
it is shown.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.base.arrays import Floats, freeze
from pipeline.base.params import setting
from pipeline.inspection.synchrony import compare_signatures, compute_signature
from pipeline.training import denoising
from pipeline.training.correlation_loss import compute_correlation_loss
from pipeline.training.denoising import DenoisingTask, TargetSensor
from pipeline.training.pair_files import TrainingPair, load_pairs
from pipeline.training.touch_residual import make_residual_example

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.recorded_pairs import RecordedPairs
    from pipeline.training.task import Example, Split

_TURNED_DEG, _LARGER, _SHIFTED = 5.0, 0.05, 0.03  # at most; of a picture's rows
_BRIGHTER = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class PairFineTuningTask(DenoisingTask):
    """Which pairs are learned from."""

    target: TargetSensor = setting(
        "soft_bubble", "Target", choices=TargetSensor, help="the other one of the two is the source"
    )
    recording: str = setting("", "Recording", help="of both sensors; in place of a folder")
    folder: str = setting("", "Folder", help="of drawn pairs, by number")
    n_pairs: int = setting(10, "Pairs", low=1, high=1_000_000, help="the first ones, that are learned from")
    correlation_weight: float = setting(
        0.0, "Weight of the likeness", low=0.0, high=100.0,
        help="for imprints that are known but for their scale: by correlation, beside the mean imprint",
    )  # fmt: skip
    colour_mixing: float = setting(
        0.0, "Mixing of colours", low=0.0, high=1.0, help="at most, for pictures whose colours are not to be trusted"
    )

    def sample(self, rng: np.random.Generator) -> Example:
        """One of the pairs, moved a little."""
        one = jitter_pair(self._known()[int(rng.integers(self._learned))], rng)
        return self._example(
            mix_colours(one, rng, self.colour_mixing) if self.kind == "bubble" and self.colour_mixing > 0.0 else one
        )

    def make_validation_example(self, split: Split, index: int) -> Example:  # noqa: ARG002 - recorded pairs are of one kind
        """One of the others; where there are none, one that was learned from."""
        known = self._known()
        rest = known[self._learned :] or known
        return self._example(rest[index % len(rest)])

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """See `denoising.loss`; by likeness alone one step is learned, and no sample."""
        if self.correlation_weight <= 0.0:
            return denoising.compute_denoising_loss(network, batch, self.contact_weight, self.slope_weight)
        return compute_correlation_loss(network, batch, self._mean(), self.correlation_weight)

    def _mean(self) -> Floats:
        """The mean imprint (rows, cols) of those that are learned from."""
        return np.stack([one.indentation_mm for one in self._known()[: self._learned]]).mean(axis=0, dtype=np.float32)

    @property
    def _learned(self) -> int:
        return min(self.n_pairs, len(self._known()))

    def collect_notes(self) -> tuple[str, ...]:
        """What is to be said of the pairs before they are learned from; raises what opening them does."""
        n, known = self._learned, len(self._known())
        asked = f" ({self.n_pairs} were asked for)" if self.n_pairs > known else ""
        alone = (
            f"all {n} pairs are learned from{asked}, none is held out: figures called unseen are of these very pairs",
        )
        order = compare_signatures(
            [compute_signature(np.abs(one.condition[:-1]).sum(axis=0)) for one in self._known()],
            [compute_signature(one.indentation_mm) for one in self._known()],
        )
        doubts = () if order is None or order.warning is None else (order.warning,)
        return (*doubts, *(self._recorded().notes if self.recording else ()), *(alone if n == known else ()))

    def _known(self) -> tuple[TrainingPair, ...]:
        return self._recorded().pairs if self.recording else load_pairs(self.folder)

    def _recorded(self) -> RecordedPairs:
        from pipeline.training.recorded_pairs import load_recorded_pairs

        source = "gelslim" if self.kind == "bubble" else "soft_bubble"
        return load_recorded_pairs(self.recording, source, self.target)

    def _example(self, one: TrainingPair) -> Example:
        return make_residual_example(
            one.condition, one.indentation_mm, one.contact, np.zeros(one.contact.shape, np.bool_), self.kind
        )


def jitter_pair(one: TrainingPair, rng: np.random.Generator) -> TrainingPair:
    """The same pair a little turned, larger and shifted, its source's reading as much stronger or weaker."""
    import cv2

    rows, cols = one.contact.shape
    turn, larger = math.radians(rng.uniform(-_TURNED_DEG, _TURNED_DEG)), 1.0 + rng.uniform(-_LARGER, _LARGER)
    across, down = rng.uniform(-_SHIFTED, _SHIFTED, 2) * rows
    cos, sin = larger * math.cos(turn), larger * math.sin(turn)
    x, y = (cols - 1) / 2, (rows - 1) / 2
    how = np.array([[cos, -sin, x - cos * x + sin * y + across], [sin, cos, y - sin * x - cos * y + down]])

    def warp(field: Any) -> Floats:
        return np.asarray(cv2.warpAffine(np.asarray(field, np.float32), how, (cols, rows), flags=cv2.INTER_LINEAR,
                                         borderMode=cv2.BORDER_REPLICATE), np.float32)  # fmt: skip

    shown = np.stack([warp(channel) for channel in one.condition])
    shown[:-1] *= np.float32(1.0 + rng.uniform(-_BRIGHTER, _BRIGHTER))  # the last channel says where there is a reading
    return TrainingPair(
        condition=freeze(shown),
        indentation_mm=freeze(warp(one.indentation_mm)),
        contact=freeze(warp(one.contact) > 0.5),
    )


def mix_colours(one: TrainingPair, rng: np.random.Generator, most: float) -> TrainingPair:
    """The same pair with the colours of a gel's picture mixed into each other, each by `most` of another at most."""
    n = len(one.condition) // 3 * 3
    colours = one.condition[:n].reshape(3, -1)
    how = np.eye(3) + rng.uniform(-most, most, (3, 3))
    shown = np.concatenate([(how.astype(np.float32) @ colours).reshape(one.condition[:n].shape), one.condition[n:]])
    return replace(one, condition=freeze(shown))
