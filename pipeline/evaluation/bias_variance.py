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
class BiasVariance:
    """Samples of one membrane (rows, cols), in mm."""

    n_samples: int
    mean_mm: Floats
    std_mm: Floats  # standard deviation of one sample
    bias_mm: Floats | None  # the mean less the truth; None where that is not known
    mask: Mask  # what the sentence speaks of: the true contact, else all

    @property
    def rms_std_mm(self) -> float:
        """Of one sample about the mean, root mean square over `where`."""
        return _rms(self.std_mm, self.mask)

    @property
    def rms_bias_mm(self) -> float:
        """Of the mean about the truth, as above; NaN where that is not known."""
        return math.nan if self.bias_mm is None else _rms(self.bias_mm, self.mask)

    @property
    def summary(self) -> str:
        """How far a sample is off, and how much of that is luck."""
        spread = f"one of {self.n_samples} samples spreads by {self.rms_std_mm:.3g} mm"
        if self.bias_mm is None or not math.isfinite(self.rms_bias_mm):
            return f"{spread}; how far it is off is not known"
        # What the mean of a few samples is off by chance is no bias.
        chance_sq = self.rms_std_mm**2
        bias_sq = max(0.0, self.rms_bias_mm**2 - chance_sq / self.n_samples)
        share = chance_sq / max(chance_sq + bias_sq, 1e-30)
        told = "luck" if share > 0.5 else "bias, which no further sample takes away"
        return (
            f"{spread} in contact and is off by {math.sqrt(chance_sq + bias_sq):.3g} mm (rms): "
            f"{max(share, 1.0 - share):.0%} of the square is {told}"
        )

    def compute_reliability_curve(self) -> Doubles:
        """(k, 2): mean spread and rms error of the mean, of pixels with about as much spread each; empty if unknown."""
        if self.bias_mm is None:
            return np.zeros((0, 2))
        known = np.isfinite(self.bias_mm) & np.isfinite(self.std_mm)
        spread, off = self.std_mm[known].astype(np.float64), self.bias_mm[known].astype(np.float64)
        order = np.argsort(spread, kind="stable")
        parts = [part for part in np.array_split(order, _BINS) if part.size >= _FEWEST]
        found = [(spread[part].mean(), math.sqrt(float((off[part] ** 2).mean()))) for part in parts]
        return np.array(found).reshape(-1, 2)


def estimate_bias_variance(samples_mm: Sequence[Floats], true_mm: Floats | None, contact: Mask | None) -> BiasVariance:
    """What samples (rows, cols) say; `contact` is the true one. Raises SettingProblem for fewer than two."""
    if len(samples_mm) < 2:
        raise SettingProblem("a spread needs two samples or more")
    stack = np.asarray(samples_mm, np.float64)
    mean = stack.mean(axis=0)
    shape = mean.shape
    fits = true_mm is not None and true_mm.shape == shape
    where = contact if contact is not None and contact.shape == shape and contact.any() else np.ones(shape, np.bool_)
    return BiasVariance(
        n_samples=len(samples_mm), mean_mm=freeze(mean.astype(np.float32)),
        std_mm=freeze(stack.std(axis=0, ddof=1).astype(np.float32)),
        bias_mm=freeze((mean - true_mm).astype(np.float32)) if fits else None, mask=where,
    )  # fmt: skip


def _rms(values: Floats, where: Mask) -> float:
    inside = values[where].astype(np.float64)
    inside = inside[np.isfinite(inside)]
    return math.sqrt(float((inside**2).mean())) if inside.size else math.nan
