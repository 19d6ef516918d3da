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
from pipeline.inspection.same_moments import felt, together
from pipeline.training import denoising
from pipeline.training.denoising import Denoising, Target
from pipeline.training.drawn_pairs import Drawn, drawn
from pipeline.training.likeness import likeness
from pipeline.training.residual import example

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.recorded_pairs import Recorded
    from pipeline.training.task import Example, Split

_TURNED_DEG, _LARGER, _SHIFTED = 5.0, 0.05, 0.03  # at most; of a picture's rows
_BRIGHTER = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptPairs(Denoising):
    """Which pairs are learned from."""

    target: Target = setting("soft_bubble", "Target", choices=Target, help="the other one of the two is the source")
    recording: str = setting("", "Recording", help="of both sensors; in place of a folder")
    folder: str = setting("", "Folder", help="of drawn pairs, by number")
    pairs: int = setting(10, "Pairs", low=1, high=1_000_000, help="the first ones, that are learned from")
    alike: float = setting(
        0.0, "Weight of the likeness", low=0.0, high=100.0,
        help="for imprints that are known but for their scale: by correlation, beside the mean imprint",
    )  # fmt: skip
    mixed: float = setting(
        0.0, "Mixing of colours", low=0.0, high=1.0, help="at most, for pictures whose colours are not to be trusted"
    )

    def sample(self, rng: np.random.Generator) -> Example:
        """One of the pairs, moved a little."""
        one = moved(self._known()[int(rng.integers(self._learned))], rng)
        return self._example(mixed(one, rng, self.mixed) if self.kind == "bubble" and self.mixed > 0.0 else one)

    def held_out(self, split: Split, index: int) -> Example:  # noqa: ARG002 - recorded pairs are of one kind
        """One of the others; where there are none, one that was learned from."""
        known = self._known()
        rest = known[self._learned :] or known
        return self._example(rest[index % len(rest)])

    def loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """See `denoising.loss`; by likeness alone one step is learned, and no sample."""
        if self.alike <= 0.0:
            return denoising.loss(network, batch, self.near, self.slopes)
        return likeness(network, batch, self._mean(), self.alike)

    def _mean(self) -> Floats:
        """The mean imprint (rows, cols) of those that are learned from."""
        return np.stack([one.touch_mm for one in self._known()[: self._learned]]).mean(axis=0, dtype=np.float32)

    @property
    def _learned(self) -> int:
        return min(self.pairs, len(self._known()))

    def notes(self) -> tuple[str, ...]:
        """What is to be said of the pairs before they are learned from; raises what opening them does."""
        n, known = self._learned, len(self._known())
        asked = f" ({self.pairs} were asked for)" if self.pairs > known else ""
        alone = (
            f"all {n} pairs are learned from{asked}, none is held out: figures called unseen are of these very pairs",
        )
        order = together(
            [felt(np.abs(one.shown[:-1]).sum(axis=0)) for one in self._known()],
            [felt(one.touch_mm) for one in self._known()],
        )
        doubts = () if order is None or order.doubt is None else (order.doubt,)
        return (*doubts, *(self._recorded().notes if self.recording else ()), *(alone if n == known else ()))

    def _known(self) -> tuple[Drawn, ...]:
        return self._recorded().pairs if self.recording else drawn(self.folder)

    def _recorded(self) -> Recorded:
        from pipeline.training.recorded_pairs import recorded_pairs

        source = "gelslim" if self.kind == "bubble" else "soft_bubble"
        return recorded_pairs(self.recording, source, self.target)

    def _example(self, one: Drawn) -> Example:
        return example(one.shown, one.touch_mm, one.contact, np.zeros(one.contact.shape, np.bool_), self.kind)


def moved(one: Drawn, rng: np.random.Generator) -> Drawn:
    """The same pair a little turned, larger and shifted, its source's reading as much stronger or weaker."""
    import cv2

    rows, cols = one.contact.shape
    turn, larger = math.radians(rng.uniform(-_TURNED_DEG, _TURNED_DEG)), 1.0 + rng.uniform(-_LARGER, _LARGER)
    across, down = rng.uniform(-_SHIFTED, _SHIFTED, 2) * rows
    cos, sin = larger * math.cos(turn), larger * math.sin(turn)
    x, y = (cols - 1) / 2, (rows - 1) / 2
    how = np.array([[cos, -sin, x - cos * x + sin * y + across], [sin, cos, y - sin * x - cos * y + down]])

    def laid(field: Any) -> Floats:
        return np.asarray(cv2.warpAffine(np.asarray(field, np.float32), how, (cols, rows), flags=cv2.INTER_LINEAR,
                                         borderMode=cv2.BORDER_REPLICATE), np.float32)  # fmt: skip

    shown = np.stack([laid(channel) for channel in one.shown])
    shown[:-1] *= np.float32(1.0 + rng.uniform(-_BRIGHTER, _BRIGHTER))  # the last channel says where there is a reading
    return Drawn(shown=freeze(shown), touch_mm=freeze(laid(one.touch_mm)), contact=freeze(laid(one.contact) > 0.5))


def mixed(one: Drawn, rng: np.random.Generator, most: float) -> Drawn:
    """The same pair with the colours of a gel's picture mixed into each other, each by `most` of another at most."""
    n = len(one.shown) // 3 * 3
    colours = one.shown[:n].reshape(3, -1)
    how = np.eye(3) + rng.uniform(-most, most, (3, 3))
    shown = np.concatenate([(how.astype(np.float32) @ colours).reshape(one.shown[:n].shape), one.shown[n:]])
    return replace(one, shown=freeze(shown))
