"""Where a network is unsure, what it corrects is left as it is: how much of a correction is taken, pixel by pixel.

A correction that is as small as the error expected of it is half taken, one that is far larger nearly all. What is
expected was learned from touches that nothing else was learned from; how much larger the error has to be taken for is
chosen by `benchmarks/caution.py`, where the source felt something and beyond: of objects that it has never seen a
network is surer than it should be.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.stages.generate.corrected import on_grid
from pipeline.stages.generate.diffusion import Sampled, State
from pipeline.values.results import DepthMap

_EVEN_PX = 4.0  # a share that changed faster would draw edges of its own
_HALF = 0.5


def held_back(found: Sampled, known: Mask, caution: float, doubts: tuple[float, float]) -> Sampled:
    """A middle of all samples, of which only what is sure is taken; `known` is where the source felt.

    `caution` 0 takes all of it, 1 holds back by `doubts`: times the expected error, where it felt and beyond. Contact
    is held back where the source felt; beyond, where nothing else is known of it, it is left as it is.
    """
    middle, spread = found.last.residual_mm, found.spread_mm
    within = on_grid(known, middle.shape) > _HALF
    share = taken(middle, np.where(within, *map(np.float32, doubts)) * spread)
    share = 1.0 - caution * (1.0 - share)

    def less(state: State) -> State:
        contact = np.where(within, share, np.float32(1.0)) * state.contact
        residual = (share * state.residual_mm).astype(np.float32)
        return replace(state, residual_mm=freeze(residual), contact=freeze(contact.astype(np.float32)))

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
