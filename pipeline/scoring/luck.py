"""Luck or bias: what several samples of one touch have in common, how far they spread, and how far all of them are off.

A sampler that knows what it does not know spreads as much as it errs. Where it errs more than it spreads, drawing more
samples helps nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Mask, freeze
from pipeline.base.errors import SettingProblem

_BINS = 12
_FEWEST = 30  # pixels that a point of the curve rests on


@dataclass(frozen=True, slots=True, kw_only=True)
class Luck:
    """Samples of one membrane (rows, cols), in mm."""

    count: int
    mean_mm: Floats
    spread_mm: Floats  # standard deviation of one sample
    off_mm: Floats | None  # the mean less the truth; None where that is not known
    where: Mask  # what the sentence speaks of: the true contact, else all

    @property
    def rms_spread_mm(self) -> float:
        """Of one sample about the mean, root mean square over `where`."""
        return _rms(self.spread_mm, self.where)

    @property
    def rms_off_mm(self) -> float:
        """Of the mean about the truth, as above; NaN where that is not known."""
        return math.nan if self.off_mm is None else _rms(self.off_mm, self.where)

    @property
    def sentence(self) -> str:
        """How far a sample is off, and how much of that is luck."""
        spread = f"one of {self.count} samples spreads by {self.rms_spread_mm:.3g} mm"
        if self.off_mm is None or not math.isfinite(self.rms_off_mm):
            return f"{spread}; how far it is off is not known"
        # What the mean of a few samples is off by chance is no bias.
        chance_sq = self.rms_spread_mm**2
        bias_sq = max(0.0, self.rms_off_mm**2 - chance_sq / self.count)
        share = chance_sq / max(chance_sq + bias_sq, 1e-30)
        told = "luck" if share > 0.5 else "bias, which no further sample takes away"
        return (
            f"{spread} in contact and is off by {math.sqrt(chance_sq + bias_sq):.3g} mm (rms): "
            f"{max(share, 1.0 - share):.0%} of the square is {told}"
        )

    def curve(self) -> Doubles:
        """(k, 2): mean spread and rms error of the mean, of pixels with about as much spread each; empty if unknown."""
        if self.off_mm is None:
            return np.zeros((0, 2))
        known = np.isfinite(self.off_mm) & np.isfinite(self.spread_mm)
        spread, off = self.spread_mm[known].astype(np.float64), self.off_mm[known].astype(np.float64)
        order = np.argsort(spread, kind="stable")
        parts = [part for part in np.array_split(order, _BINS) if part.size >= _FEWEST]
        found = [(spread[part].mean(), math.sqrt(float((off[part] ** 2).mean()))) for part in parts]
        return np.array(found).reshape(-1, 2)


def luck(samples_mm: Sequence[Floats], true_mm: Floats | None, contact: Mask | None) -> Luck:
    """What samples (rows, cols) say; `contact` is the true one. Raises SettingProblem for fewer than two."""
    if len(samples_mm) < 2:
        raise SettingProblem("a spread needs two samples or more")
    stack = np.asarray(samples_mm, np.float64)
    mean = stack.mean(axis=0)
    shape = mean.shape
    fits = true_mm is not None and true_mm.shape == shape
    where = contact if contact is not None and contact.shape == shape and contact.any() else np.ones(shape, np.bool_)
    return Luck(
        count=len(samples_mm), mean_mm=freeze(mean.astype(np.float32)),
        spread_mm=freeze(stack.std(axis=0, ddof=1).astype(np.float32)),
        off_mm=freeze((mean - true_mm).astype(np.float32)) if fits else None, where=where,
    )  # fmt: skip


def _rms(values: Floats, where: Mask) -> float:
    inside = values[where].astype(np.float64)
    inside = inside[np.isfinite(inside)]
    return math.sqrt(float((inside**2).mean())) if inside.size else math.nan
