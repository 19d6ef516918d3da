"""Pairs drawn on the target's own grid, as a network of touch to touch is shown them, kept in a folder by number."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from pipeline.base.arrays import Floats, Mask
from pipeline.base.errors import FileProblem
from pipeline.training.target_touches import load_arrays, save_arrays


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingPair:
    """A pair on the target's grid."""

    condition: Floats  # (channels, rows, cols) as `picture_input.of_picture` draws it
    indentation_mm: Floats  # (rows, cols) the target's membrane
    contact: Mask


def save_pair(folder: Path, number: int, one: TrainingPair) -> None:
    """Keep a pair under its number."""
    save_arrays(folder / f"pair_{number:05}.npz", one)


@lru_cache(maxsize=4)
def load_pairs(folder: str) -> tuple[TrainingPair, ...]:
    """The pairs of a folder in their order; raises FileProblem where there is none."""
    found = tuple(
        one for path in sorted(Path(folder).glob("pair_*.npz")) if (one := load_arrays(path, TrainingPair)) is not None
    )
    if not found:
        raise FileProblem("there is no drawn pair here (pair_00000.npz and so on)", folder)
    return found
