"""One touch felt by a gel and by a bubble: what touch to touch learns from. Kept by number as `own_touches` are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.base.memo import Memo
from pipeline.physics import optics
from pipeline.sensors.spec import SensorSpec, sensor
from pipeline.simulation import poses, variation
from pipeline.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.simulation.press import press
from pipeline.stages.generate.residual_input import working
from pipeline.training.own_touches import KINDS, Things, keep, nearer, read, thing_of

VERSION = 1  # counts up when the same number would give another pair
GEL, BUBBLE = "gelslim", "soft_bubble"
_AS_RECORDED, _DEEPER_MM = 0.8, (5.0, 11.0)
_MOST_BYTES = 1 << 30  # of pairs that a worker remembers


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Both sides of a touch on their working grids."""

    change_grey: Floats  # (rows, cols, 3) of the gel's picture, with its noise
    gel_mm: Floats
    gel_contact: Mask
    bubble_mm: Floats  # without noise
    bubble_contact: Mask
    deeper_mm: Floats  # (1,) how much farther the bubble came to meet the object than described


def units(deeper_mm: float) -> tuple[SensorSpec, SensorSpec]:
    """Gel and bubble as described, on their working grids and as they stood."""
    gel, bubble = _described()
    return gel, nearer(bubble, deeper_mm)


def pair(things: Things, seed: int, index: int, folder: str = "") -> Pair | None:
    """Pair `index` of a seed: the same each time; None where the gel feels nothing. `folder` keeps it."""
    found = _in_memory.of((things, seed, index), lambda: _kept_or_made(things, seed, index, folder))
    return found if found.gel_contact.any() else None


def _kept_or_made(things: Things, seed: int, index: int, folder: str) -> Pair:
    path = Path(folder) / f"pair_{things}_{seed}_{index}.npz" if folder else None
    found = None if path is None else read(path, Pair)
    if found is None:
        rng = np.random.default_rng([VERSION, 13, KINDS.index(things), seed, index])
        found = _made(things, rng, index)
        if path is not None:
            keep(path, found)
    return found


def _made(things: Things, rng: np.random.Generator, index: int) -> Pair:
    usual = things != "learned" or rng.random() < _AS_RECORDED
    deeper = BUBBLE_DEEPER_MM if usual else rng.uniform(*_DEEPER_MM)
    gel, bubble = (variation.varied(unit, int(rng.integers(1 << 31)), 1.0) for unit in units(deeper))
    thing = thing_of(things, rng, index)
    pose = poses.single(thing, rng)
    below = press(thing, pose, gel, seed=int(rng.integers(1 << 31)))
    above = press(thing, pose, bubble, seed=None).truth
    under = below.truth
    assert under.indentation_mm is not None
    assert under.contact is not None
    assert above.indentation_mm is not None
    assert above.contact is not None
    change = below.image.astype(np.float32) - optics.untouched(gel).astype(np.float32)
    return Pair(
        change_grey=_as_kept(change), gel_mm=_as_kept(under.indentation_mm), gel_contact=under.contact,
        bubble_mm=_as_kept(above.indentation_mm), bubble_contact=above.contact,
        deeper_mm=_as_kept(np.array([deeper], np.float32)),
    )  # fmt: skip


_in_memory: Memo[tuple[Things, int, int], Pair] = Memo(most_bytes=_MOST_BYTES)


@lru_cache(maxsize=1)
def _described() -> tuple[SensorSpec, SensorSpec]:
    return working(sensor(GEL)), working(sensor(BUBBLE))


def _as_kept(a: Floats) -> Floats:
    return freeze(a.astype(np.float16).astype(np.float32))
