"""Classifier-free guidance with safe limits and no unused network passes.

guided = unconditional + weight * (conditional - unconditional) (Ho and Salimans 2022). Where the
condition nearly determines the result, guidance only narrows the samples; far outside the data it
overshoots. Measured limits: below four steps there is nothing left to guide. Below twenty steps a
weight above 1.5 makes higher-degree solvers diverge: the degree is then 0, guidance acts at middle
noise levels only, and values outside the data range are pulled back.

The unconditional output exists only where the condition was left out of some training examples.
Other networks, such as the released checkpoints of touch to touch, are sampled with their condition
alone, whatever the weight.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar, cast

from pipeline.core.errors import SettingProblem
from pipeline.core.params import list_settings, replace_value
from pipeline.stages.networks.samplers import Denoiser

P = TypeVar("P")
MAX_WEIGHT = 15.0
# where guidance shows its effect, for a sweep
GUIDED_STEPS = (4, 8, 16, 50)
WEIGHTS = (1.0, 2.5, 4.0, 7.0)
NO_CONDITION_DROPOUT = (
    "guidance has no effect: these weights were trained without condition dropout"
)
_MIN_STEPS = 4
_SAFE_STEPS = 20
_SAFE_WEIGHT = 1.5
# sigma over data range (Kynkaanniemi et al. 2024: guide in a limited interval)
_INTERVAL = (0.02, 1.0)
_STEPS_PER_WEIGHT = 12  # steps per unit of weight that a degree above 0 needs, measured


@dataclass(frozen=True, slots=True, kw_only=True)
class GuidancePlan:
    """How a requested guidance weight is applied."""

    weight: float
    max_degree: int
    interval: tuple[float, float] | None  # range of sigma with guidance; None = everywhere
    note: str = ""  # what differs from the request, in words


def plan_guidance(
    weight: float, steps: int, data_range: float, *, trained_with_condition_dropout: bool = True
) -> GuidancePlan:
    """Plan guidance of this weight for a number of steps.

    `data_range` is the largest valid clean value.

    A network that was trained without condition dropout is sampled with a weight of 1.

    Raises SettingProblem for a weight outside 0 to `MAX_WEIGHT`.
    """
    if not 0.0 <= weight <= MAX_WEIGHT:
        raise SettingProblem(
            f"the guidance scale must lie between 0 and {MAX_WEIGHT:g}, got {weight!r}"
        )
    if not trained_with_condition_dropout:
        return GuidancePlan(
            weight=1.0,
            max_degree=2,
            interval=None,
            note="" if weight == 1.0 else NO_CONDITION_DROPOUT,
        )
    if weight in (0.0, 1.0):
        return GuidancePlan(weight=weight, max_degree=2, interval=None)
    if steps < _MIN_STEPS:
        note = f"guidance needs at least {_MIN_STEPS} steps: sampled without guidance"
        return GuidancePlan(weight=1.0, max_degree=2, interval=None, note=note)
    if weight <= _SAFE_WEIGHT or steps >= max(_SAFE_STEPS, _STEPS_PER_WEIGHT * weight):
        return GuidancePlan(
            weight=weight, max_degree=2 if weight <= _SAFE_WEIGHT else 1, interval=None
        )
    low, high = (share * data_range for share in _INTERVAL)
    note = (
        f"few steps for a guidance of {weight:g}: first order, guided at middle noise levels only"
    )
    return GuidancePlan(weight=weight, max_degree=0, interval=(low, high), note=note)


def raise_steps(old: P, new: P) -> P:
    """`new` parameters with 8 steps if the guidance was changed and acts only with more steps
    than they have.
    """
    names = list_settings(new).keys()
    least = _MIN_STEPS
    before = cast("Any", old)
    after = cast("Any", new)
    if (
        not {"guidance", "steps"} <= names
        or after.guidance in (before.guidance, 1.0)
        or after.steps >= least
    ):
        return new
    return replace_value(new, "steps", GUIDED_STEPS[1])


class GuidedDenoiser:
    """A guided denoiser that counts its passes: one per step for a weight of 0 or 1, else two.

    `denoise_both` returns (conditional, unconditional) of one batched call, where that is cheaper.
    """

    def __init__(
        self,
        conditional: Denoiser,
        unconditional: Denoiser,
        plan: GuidancePlan,
        data_range: float,
        denoise_both: Callable[[Any, float], tuple[Any, Any]] | None = None,
    ) -> None:
        self._conditional = conditional
        self._unconditional = unconditional
        self._plan = plan
        self._range = data_range
        self._denoise_both = denoise_both
        self.passes = 0

    def __call__(self, noisy: Any, sigma: float) -> Any:
        """The expected clean array, within the data range."""
        plan = self._plan
        guided = plan.interval is None or plan.interval[0] <= sigma <= plan.interval[1]
        weight = plan.weight if guided else 1.0
        self.passes += 1
        if weight == 1.0:
            return self._conditional(noisy, sigma).clip(-self._range, self._range)
        if weight == 0.0:
            return self._unconditional(noisy, sigma).clip(-self._range, self._range)
        self.passes += 1
        if self._denoise_both is not None:
            conditional, unconditional = self._denoise_both(noisy, sigma)
        else:
            conditional = self._conditional(noisy, sigma)
            unconditional = self._unconditional(noisy, sigma)
        guided_clean = unconditional + (conditional - unconditional) * weight
        return _limit_to_range(guided_clean, conditional, self._range)


def _limit_to_range(guided: Any, conditional: Any, data_range: float) -> Any:
    """Scale the guided change down until it fits the data range (dynamic thresholding, Saharia
    et al. 2022).
    """
    largest = float(abs(guided).max())
    if largest <= data_range:
        return guided
    within = conditional.clip(-data_range, data_range)
    return (within + (guided - within) * (data_range / largest)).clip(-data_range, data_range)
