"""Bias and variance of several samples of one touch.

The standard deviation of a calibrated sampler equals its error. If the error is larger, more samples do not help.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Mask, freeze
from pipeline.base.errors import SettingProblem

_BINS = 12
_MIN_PIXELS = 30  # least number of pixels per point of the curve


@dataclass(frozen=True, slots=True, kw_only=True)
class BiasVariance:
    """Samples of one membrane (rows, cols), in mm."""

    n_samples: int
    mean_mm: Floats
    std_mm: Floats  # standard deviation of one sample
    bias_mm: Floats | None  # mean less ground truth; None if unknown
    mask: Mask  # pixels of the summary: true contact, else all

    @property
    def rms_std_mm(self) -> float:
        """Standard deviation of one sample about the mean, rms over `mask`."""
        return _rms(self.std_mm, self.mask)

    @property
    def rms_bias_mm(self) -> float:
        """Bias of the mean, rms over `mask`; NaN if unknown."""
        return math.nan if self.bias_mm is None else _rms(self.bias_mm, self.mask)

    @property
    def summary(self) -> str:
        """Error of a sample, and how much of its square is variance or bias."""
        spread = f"{self.n_samples} samples have a standard deviation of {self.rms_std_mm:.3g} mm"
        if self.bias_mm is None or not math.isfinite(self.rms_bias_mm):
            return f"{spread}; their error is not known"
        # The mean of a few samples has a random error that is not bias.
        variance_sq = self.rms_std_mm**2
        bias_sq = max(0.0, self.rms_bias_mm**2 - variance_sq / self.n_samples)
        share = variance_sq / max(variance_sq + bias_sq, 1e-30)
        cause = "variance" if share > 0.5 else "bias, which more samples do not reduce"
        return (
            f"{spread} in contact and an error of {math.sqrt(variance_sq + bias_sq):.3g} mm (rms): "
            f"{max(share, 1.0 - share):.0%} of the square is {cause}"
        )

    def compute_reliability_curve(self) -> Doubles:
        """(k, 2): mean standard deviation and rms error of the mean per group of pixels of similar spread.

        Empty if ground truth is unknown.
        """
        if self.bias_mm is None:
            return np.zeros((0, 2))
        known = np.isfinite(self.bias_mm) & np.isfinite(self.std_mm)
        std, bias = self.std_mm[known].astype(np.float64), self.bias_mm[known].astype(np.float64)
        order = np.argsort(std, kind="stable")
        parts = [part for part in np.array_split(order, _BINS) if part.size >= _MIN_PIXELS]
        points = [(std[part].mean(), math.sqrt(float((bias[part] ** 2).mean()))) for part in parts]
        return np.array(points).reshape(-1, 2)


def estimate_bias_variance(samples_mm: Sequence[Floats], true_mm: Floats | None, contact: Mask | None) -> BiasVariance:
    """Statistics of samples (rows, cols) in mm; `contact` is the true one. Raises SettingProblem for fewer than two."""
    if len(samples_mm) < 2:
        raise SettingProblem("a standard deviation needs two samples or more")
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
