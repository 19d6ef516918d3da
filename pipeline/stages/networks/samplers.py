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
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.errors import SettingProblem
from pipeline.core.progress import SILENT, Progress

Solver = Literal["ddim", "dpmpp_2m", "corrected"]
Denoiser = Callable[[Any, float], Any]  # (noisy, sigma) -> expected clean array

MAX_STEPS = 1000
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
# steps from which one degree more is better, `benchmarks/sampling.py`
_FEW_STEPS = 12
_SOME_STEPS = 24


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplerStep:
    """Expected clean array of one step."""

    sigma: float
    clean: Any


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplerResult:
    """A sample and its cost."""

    clean: Any
    passes: int  # denoiser calls
    steps: tuple[SamplerStep, ...] = ()  # only on request


def make_sigma_schedule(
    steps: int, *, sigma_max: float, sigma_min: float, rho: float = 7.0
) -> Doubles:
    """(steps + 1,) from `sigma_max` to `sigma_min`, then 0, even in sigma^(1/rho) (Karras et al.
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
    ends = sigma_max ** (1 / rho), sigma_min ** (1 / rho)
    return np.append((ends[0] + share * (ends[1] - ends[0])) ** rho, 0.0)


def make_timestep_schedule(steps: int, alphas_cumprod: Doubles) -> tuple[Doubles, tuple[int, ...]]:
    """Schedule of a network trained at integer times: (steps + 1,) sigmas and the falling times
    they belong to.

    `alphas_cumprod` (times,) is the share a of the signal's power that remains ("alpha bar"):
    sigma^2 = (1 - a) / a. The last time comes first and none twice ("trailing", Lin et al. 2024);
    the number of steps is limited to that of times.
    """
    _check_steps(steps)
    count = len(alphas_cumprod)
    n_steps = min(steps, count)
    times = np.rint(count * (1.0 - np.arange(n_steps) / n_steps)).astype(int) - 1
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
