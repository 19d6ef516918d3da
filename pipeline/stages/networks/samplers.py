"""Diffusion samplers with few, stable steps.

Noise levels are standard deviations sigma: noisy = clean + sigma * noise (Karras et al. 2022, EDM).
With lambda = -ln(sigma) the probability flow is dx/dlambda = D(x) - x, where D is the clean array
that the network expects. The linear part is solved exactly; the rest is an integral of D,
approximated by a polynomial in lambda:

    x(lambda + h) = e^-h x(lambda) + integral_0^h e^-(h - tau) D(lambda + tau) dtau

- `ddim`: D held constant (Song et al. 2021 without added noise).
- `dpmpp_2m`: a line through the last two D (Lu et al. 2022, DPM-Solver++ 2M).
- `corrected`: predictor-corrector (after UniPC, Zhao et al. 2023): a polynomial through previous D
  predicts, and the D
  at the predicted point, which the next step needs anyway, corrects. It costs no extra pass and is
  the most accurate on nearly every row of `benchmarks/sampling.py`. Its degree rises with the
  number of steps, since high degrees overshoot on long steps.

The last step goes to sigma 0, where all of them return D. Arrays may be of numpy or torch.

Classifier-free guidance with safe limits and no unused network passes.

guided = unconditional + weight * (conditional - unconditional) (Ho and Salimans 2022). Where the
condition nearly determines the result, guidance only narrows the samples; far outside the data it
overshoots. Measured limits: below four steps there is nothing left to guide. Below twenty steps a
weight above 1.5 makes higher-degree solvers diverge: the degree is then 0, guidance acts at middle
noise levels only, and values outside the data range are pulled back.

The unconditional output exists only where the condition was left out of some training examples.
Other networks, such as the released checkpoints of touch to touch, are sampled with their condition
alone, whatever the weight.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypeVar, cast

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.params import list_settings, replace_value
from pipeline.core.progress import SILENT, Progress

Solver = Literal["ddim", "dpmpp_2m", "corrected"]
SOLVERS: Mapping[Solver, str] = {
    "ddim": "DDIM",
    "dpmpp_2m": "DPM-Solver++ (2M)",
    "corrected": "predictor and corrector",
}
Denoiser = Callable[[Any, float], Any]  # (noisy, sigma) -> expected clean array

MAX_STEPS = 1000
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
# steps from which one degree more is better, `benchmarks/sampling.py`
_FEW_STEPS = 12
_SOME_STEPS = 24
_RHO = 7.0


@frozen
class SamplerStep:
    """Expected clean array of one step."""

    sigma: float
    clean: Any


@frozen
class SamplerResult:
    """A sample and its cost."""

    clean: Any
    passes: int  # denoiser calls
    steps: tuple[SamplerStep, ...] = ()  # only on request


def make_sigma_schedule(steps: int, *, sigma_max: float, sigma_min: float) -> Doubles:
    """(steps + 1,) from `sigma_max` to `sigma_min`, then 0, even in sigma^(1/7) (Karras et al.
    2022, eq. 5).

    One step goes from `sigma_max` straight to 0. Raises SettingProblem for a number of steps
    outside 1 to `MAX_STEPS`.
    """
    _check_steps(steps)
    if not 0.0 < sigma_min < sigma_max < math.inf:
        raise SettingProblem(
            f"noise must fall from a larger to a smaller positive level, got {sigma_max:g} to "
            f"{sigma_min:g}"
        )
    share = np.arange(steps) / max(1, steps - 1)
    first, last = (level ** (1 / _RHO) for level in (sigma_max, sigma_min))
    return np.append((first + share * (last - first)) ** _RHO, 0.0)


def make_timestep_schedule(
    steps: int, alphas_cumprod: Doubles, *, is_leading: bool = False
) -> tuple[Doubles, tuple[int, ...]]:
    """Schedule of a network trained at integer times: (steps + 1,) sigmas and the falling times
    they belong to.

    `alphas_cumprod` (times,) is the share a of the signal's power that remains ("alpha bar"):
    sigma^2 = (1 - a) / a. The last time comes first and none twice ("trailing", Lin et al. 2024);
    the number of steps is limited to that of times. "Leading" times, those of the published sampler
    (901, 801 ... 1 for 10 steps), leave the last ones out and are at least as many as `steps`; a
    single step, which would be at time 1 alone, is always trailing.
    """
    _check_steps(steps)
    count = len(alphas_cumprod)
    n_steps = min(steps, count)
    times = np.rint(count * (1.0 - np.arange(n_steps) / n_steps)).astype(int) - 1
    if is_leading and n_steps > 1:
        times = np.arange(1, count, count // n_steps)[::-1]
    alphas = alphas_cumprod[times]
    if not ((alphas > 0) & (alphas < 1)).all():
        raise SettingProblem(
            "the signal's share must lie between 0 and 1 at every time: at 0 nothing is left to "
            "denoise"
        )
    return np.append(np.sqrt((1 - alphas) / alphas), 0.0), tuple(int(t) for t in times)


def sample(
    denoise: Denoiser,
    noise: Any,
    levels: Sequence[float] | Doubles,
    *,
    solver: Solver = "corrected",
    max_degree: int = 2,
    keep_steps: bool = False,
    progress: Progress = SILENT,
) -> SamplerResult:
    """Sample from `noise` (standard normal, any shape) along falling noise `levels`, the last of
    them 0.

    `max_degree` limits the polynomial, 0 = constant (see `guidance.plan_guidance`). Can be
    cancelled between passes.
    """
    steps = len(levels) - 1
    predicts, corrects = (min(degree, max_degree) for degree in _degrees(solver, steps))
    x = start = noise * float(levels[0])
    history: list[tuple[float, Any]] = []
    steps_kept: list[SamplerStep] = []
    for index in range(steps):
        sigma = float(levels[index])
        progress.step(index / steps, f"step {index + 1} of {steps}")
        clean = denoise(x, sigma)
        position = -math.log(sigma)
        if corrects and history:
            previous = history[-1][0]
            x = _advance(
                start, (*history[-corrects:], (position, clean)), previous, position - previous
            )
        history = [*history[-2:], (position, clean)]
        if keep_steps:
            steps_kept.append(SamplerStep(sigma=sigma, clean=clean))
        if levels[index + 1] <= 0.0:
            break
        start = x
        x = _advance(
            start,
            history[-1 - predicts :],
            position,
            -math.log(float(levels[index + 1])) - position,
        )
    progress.step(1.0, "sampled")
    return SamplerResult(clean=history[-1][1], passes=steps, steps=tuple(steps_kept))


def _degrees(solver: Solver, steps: int) -> tuple[int, int]:
    """Degrees of the predicting and of the correcting polynomial (0 = no corrector)."""
    if solver == "ddim":
        return 0, 0
    if solver == "dpmpp_2m":
        return 1, 0
    return (0, 1) if steps < _FEW_STEPS else (1, 1) if steps < _SOME_STEPS else (2, 2)


def _advance(x: Any, history: Sequence[tuple[float, Any]], begin: float, by: float) -> Any:
    """The noisy array a step `by` in lambda further, with D as the polynomial through `history`."""
    result = x * math.exp(-by)
    for weight, (_, clean) in zip(
        _integrate_lagrange([position - begin for position, _ in history], by), history, strict=True
    ):
        result = result + clean * weight
    return result


def _integrate_lagrange(nodes_at: Sequence[float], by: float) -> list[float]:
    """Integral from 0 to `by` of e^-(by - tau) times each Lagrange polynomial of `nodes_at`."""
    low = math.exp(-by)
    # e^-(by - tau), in which the integrand is smooth
    decay = 0.5 * (1 - low) * _NODES + 0.5 * (1 + low)
    tau = by + np.log(decay)
    integrals: list[float] = []
    for j, node in enumerate(nodes_at):
        basis = np.ones_like(tau)
        for m, other in enumerate(nodes_at):
            if m != j:
                basis = basis * (tau - other) / (node - other)
        integrals.append(float(0.5 * (1 - low) * (_WEIGHTS * basis).sum()))
    return integrals


def _check_steps(steps: int) -> None:
    if not 1 <= steps <= MAX_STEPS:
        raise SettingProblem(
            f"the number of denoising steps must lie between 1 and {MAX_STEPS}, got {steps}"
        )


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


@frozen
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
    before = cast("Any", old)
    after = cast("Any", new)
    if (
        not {"guidance", "steps"} <= names
        or after.guidance in (before.guidance, 1.0)
        or after.steps >= _MIN_STEPS
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
