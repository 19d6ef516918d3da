"""Pairs drawn on the target's own grid, as a network of touch to touch is shown them, kept in a folder by number."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from pipeline.base.arrays import Floats, Mask
from pipeline.base.errors import FileProblem
from pipeline.training.own_touches import keep, read


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """A pair on the target's grid."""

    shown: Floats  # (channels, rows, cols) as `picture_input.of_picture` draws it
    touch_mm: Floats  # (rows, cols) the target's membrane
    contact: Mask


def draw(folder: Path, number: int, one: Drawn) -> None:
    """Keep a pair under its number."""
    keep(folder / f"pair_{number:05}.npz", one)


@lru_cache(maxsize=4)
def drawn(folder: str) -> tuple[Drawn, ...]:
    """The pairs of a folder in their order; raises FileProblem where there is none."""
    found = tuple(one for path in sorted(Path(folder).glob("pair_*.npz")) if (one := read(path, Drawn)) is not None)
    if not found:
        raise FileProblem("there is no drawn pair here (pair_00000.npz and so on)", folder)
    return found
