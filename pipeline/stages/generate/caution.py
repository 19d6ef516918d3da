"""Where a network is unsure, what it corrects is left as it is: how much of a correction is taken, pixel by pixel.

A correction that is as small as the error expected of it is half taken, one that is far larger nearly all. What is
expected was learned from touches that nothing else was learned from; how much larger the error has to be taken for is
chosen by `benchmarks/caution.py`, where the source felt something and beyond: of objects that it has never seen a
network is surer than it should be. What it tells may be squeezed together, too: where little is told nearly nothing is
wrong, and where much is told far more. Weights therefore carry a power of it beside how many times it counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.stages.generate.corrected import on_grid
from pipeline.stages.generate.diffusion import Sampled, State
from pipeline.values.results import DepthMap

_EVEN_PX = 4.0  # a share that changed faster would draw edges of its own
_HALF = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Trust:
    """How far off a network has to be taken for by what it tells of its own error."""

    felt: float  # how many times that error counts where the source felt
    beyond: float
    power: float = 1.0  # of that error, in `unit_mm`
    unit_mm: float = 1.0

    def off_mm(self, told_mm: Floats, felt: Mask) -> Floats:
        """(rows, cols) what is to be expected where the network tells `told_mm`."""
        times = np.where(felt, np.float32(self.felt), np.float32(self.beyond))
        return (times * told_mm * (told_mm / np.float32(self.unit_mm)) ** np.float32(self.power - 1.0)).astype(
            np.float32
        )


def trust(network: Any) -> Trust:
    """As the weights of a `residual_denoiser` have it."""
    felt, beyond = network.doubts
    return Trust(felt=felt, beyond=beyond, power=network.doubt_power, unit_mm=network.unit_mm)


def held_back(found: Sampled, known: Mask, caution: float, trusted: Trust, *, contact: bool = True) -> Sampled:
    """A middle of all samples, of which only what is sure is taken; `known` is where the source felt.

    `caution` 0 takes all of it, 1 holds back by all that is `trusted` no further. Contact is held back as the membrane
    is where the source felt, and less so beyond, where nothing else is known of it (the root of the share: overlap
    0.473 instead of 0.460 with all of it, on 160 touches that are in no table). Without `contact` that of the first
    answer stays where the source felt.
    """
    middle, spread = found.last.residual_mm, found.spread_mm
    within = on_grid(known, middle.shape) > _HALF
    share = 1.0 - caution * (1.0 - taken(middle, trusted.off_mm(spread, within)))
    of_contact = np.where(within, share if contact else np.float32(1.0 - caution), np.sqrt(share))

    def less(state: State) -> State:
        residual = (share * state.residual_mm).astype(np.float32)
        return replace(
            state, residual_mm=freeze(residual), contact=freeze((of_contact * state.contact).astype(np.float32))
        )  # fmt: skip

    return replace(found, last=less(found.last), states=tuple(less(state) for state in found.states))


def contradiction(found: Sampled, felt: Mask) -> float:
    """How many times farther than it expects a network is from what the source felt itself; 0 where it felt nothing."""
    off, expected = np.abs(found.last.residual_mm), found.spread_mm
    there = on_grid(felt, off.shape) > _HALF
    return float(off[there].mean() / max(float(expected[there].mean()), 1e-9)) if there.any() else 0.0


def taken(correction_mm: Floats, off_mm: Floats) -> Floats:
    """The share 0..1 of a correction (rows, cols) that is expected to be off by so much."""
    large, wrong = (_even(np.square(f, dtype=np.float32)) for f in (correction_mm, off_mm))
    return np.where(wrong > 0.0, large / np.maximum(large + wrong, np.float32(1e-12)), np.float32(1.0))


def _even(field: Floats) -> Floats:
    import cv2

    return np.asarray(cv2.GaussianBlur(field, (0, 0), _EVEN_PX), np.float32)


def against(found: Sampled, first: DepthMap) -> Sampled:
    """The same touch told as a correction of `first`; until now it was one of the untouched target."""
    shape = found.spread_mm.shape
    deep, touched = on_grid(first.indentation_mm, shape), on_grid(first.contact, shape)

    def told(state: State) -> State:
        return replace(
            state, residual_mm=freeze(state.residual_mm - deep), contact=freeze(state.contact - touched)
        )  # fmt: skip

    return replace(found, last=told(found.last), states=tuple(told(state) for state in found.states))
