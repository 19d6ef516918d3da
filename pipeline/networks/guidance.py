"""Classifier-free guidance that neither diverges nor pays for what it does not use.

guided = unconditional + weight * (conditional - unconditional) (Ho and Salimans 2022). Where the answer is nearly
determined by its condition, guidance only narrows the samples; far outside the data it overshoots. Measured limits:
below four steps nothing is left to guide, and below twenty a weight above 1.5 breaks higher degrees, so that there the
degree is held at 0, guidance works in the middle of the noise only, and what leaves the data's range is drawn back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pipeline.base.errors import SettingProblem
from pipeline.networks.samplers import Denoiser

MAX_WEIGHT = 15.0
_LEAST_STEPS, _SAFE_STEPS, _SAFE_WEIGHT = 4, 20, 1.5
_INTERVAL = (0.02, 1.0)  # of the data's range, as sigma (Kynkaanniemi et al. 2024: guide in a limited interval)
_STEPS_PER_WEIGHT = 12  # a degree above 0 needs about this many steps for each unit of weight


@dataclass(frozen=True, slots=True, kw_only=True)
class GuidancePlan:
    """How a wish for guidance is carried out."""

    weight: float
    max_degree: int
    interval: tuple[float, float] | None  # of sigma, in which guidance works; None: everywhere
    note: str = ""  # what was done otherwise than asked, in words


def plan_guidance(weight: float, steps: int, data_range: float) -> GuidancePlan:
    """What a weight of guidance becomes at this number of steps; `data_range` is the largest clean value that is sound.

    Raises SettingProblem for a weight outside 0 to `MOST_WEIGHT`.
    """
    if not 0.0 <= weight <= MAX_WEIGHT:
        raise SettingProblem(f"the guidance scale must lie between 0 and {MAX_WEIGHT:g}, got {weight!r}")
    if weight in (0.0, 1.0):
        return GuidancePlan(weight=weight, max_degree=2, interval=None)
    if steps < _LEAST_STEPS:
        note = f"guidance needs at least {_LEAST_STEPS} steps: sampled without it"
        return GuidancePlan(weight=1.0, max_degree=2, interval=None, note=note)
    if weight <= _SAFE_WEIGHT or steps >= max(_SAFE_STEPS, _STEPS_PER_WEIGHT * weight):
        return GuidancePlan(weight=weight, max_degree=2 if weight <= _SAFE_WEIGHT else 1, interval=None)
    low, high = (share * data_range for share in _INTERVAL)
    note = f"few steps for a guidance of {weight:g}: first order, and guided in the middle of the noise only"
    return GuidancePlan(weight=weight, max_degree=0, interval=(low, high), note=note)


class GuidedDenoiser:
    """A denoiser of both; counts its passes, of which a weight of 0 or 1 needs one a step.

    `together` gives (conditional, unconditional) in one go, for those whom two cost less so.
    """

    def __init__(
        self, conditional: Denoiser, unconditional: Denoiser, plan: GuidancePlan, data_range: float,
        denoise_both: Callable[[Any, float], tuple[Any, Any]] | None = None,
    ) -> None:  # fmt: skip
        self._conditional, self._unconditional, self._plan, self._range = conditional, unconditional, plan, data_range
        self._together = denoise_both
        self.passes = 0

    def __call__(self, noisy: Any, sigma: float) -> Any:
        """The clean array that is expected, within the data's range."""
        plan = self._plan
        guided = plan.interval is None or plan.interval[0] <= sigma <= plan.interval[1]
        weight = plan.weight if guided else 1.0
        self.passes += 1
        if weight == 1.0:
            return self._conditional(noisy, sigma).clip(-self._range, self._range)
        if weight == 0.0:
            return self._unconditional(noisy, sigma).clip(-self._range, self._range)
        self.passes += 1
        if self._together is not None:
            conditional, unconditional = self._together(noisy, sigma)
        else:
            conditional, unconditional = self._conditional(noisy, sigma), self._unconditional(noisy, sigma)
        guided_clean = unconditional + (conditional - unconditional) * weight
        return _drawn_back(guided_clean, conditional, self._range)


def _drawn_back(guided: Any, conditional: Any, data_range: float) -> Any:
    """The change by guidance made so small that the range holds it, the idea of dynamic thresholds (Saharia 2022)."""
    largest = float(abs(guided).max())
    if largest <= data_range:
        return guided
    within = conditional.clip(-data_range, data_range)
    return (within + (guided - within) * (data_range / largest)).clip(-data_range, data_range)
