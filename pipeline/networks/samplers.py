"""From noise to a sample in few, safe steps.

Everything is told by the noise's standard deviation sigma: noisy = clean + sigma * noise (Karras et al. 2022, EDM).
With lambda = -ln(sigma) the probability flow is dx/dlambda = D(x) - x, where D is the clean array that the network
expects. Its linear part is solved exactly; what is left is an integral of D, taken through a polynomial in lambda:

    x(lambda + h) = e^-h x(lambda) + integral_0^h e^-(h - tau) D(lambda + tau) dtau

- `ddim`: D held constant (Song et al. 2021 without added noise).
- `dpmpp_2m`: a line through the last two D (Lu et al. 2022, DPM-Solver++ 2M).
- `corrected`: a polynomial through what has been seen predicts, and the D at the predicted place, which the next step
  needs anyway, corrects (the idea of UniPC, Zhao et al. 2023): no pass more, and the most accurate of the three on
  nearly every row of `benchmarks/sampling.py`. Its degree rises with the number of steps: high degrees overshoot where
  steps are long.

The last step goes to sigma 0, where all of them give D itself. Arrays are taken as they come, numpy's or torch's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.base.errors import SettingProblem
from pipeline.base.progress import SILENT, Progress

Solver = Literal["ddim", "dpmpp_2m", "corrected"]
Denoiser = Callable[[Any, float], Any]  # (noisy, sigma) -> the clean array that is expected

MAX_STEPS = 1000
_FEW, _SOME = 12, 24  # steps from which a degree more pays, `benchmarks/sampling.py`


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplerStep:
    """What a step began with and what it expected, for looking at."""

    sigma: float
    noisy: Any
    clean: Any


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplerResult:
    """A sample and how it was come by."""

    clean: Any
    passes: int  # calls of the denoiser
    steps: tuple[SamplerStep, ...] = ()  # kept on request


def make_sigma_schedule(steps: int, *, sigma_max: float, sigma_min: float, rho: float = 7.0) -> Doubles:
    """(steps + 1,) from `most` down to `least`, then 0, evenly spaced in sigma^(1/bend) (Karras et al. 2022, eq. 5).

    One step goes from `most` straight to 0. Raises SettingProblem for fewer than one or more than `MOST_STEPS` steps.
    """
    _check_steps(steps)
    if not 0.0 < sigma_min < sigma_max < math.inf:
        raise SettingProblem(
            f"noise must fall from a larger to a smaller positive level, got {sigma_max:g} to {sigma_min:g}"
        )
    share = np.arange(steps) / max(1, steps - 1)
    ends = sigma_max ** (1 / rho), sigma_min ** (1 / rho)
    return np.append((ends[0] + share * (ends[1] - ends[0])) ** rho, 0.0)


def make_timestep_schedule(steps: int, alphas_cumprod: Doubles) -> tuple[Doubles, tuple[int, ...]]:
    """As `sigmas`, of a network trained at whole times: (steps + 1,) levels, and the times they belong to, falling.

    `cumulative` (times,) is the share a of the signal's power that is left, usually called alpha bar:
    sigma^2 = (1 - a) / a. The last time comes first and none comes twice ("trailing", Lin et al. 2024): more steps than
    there are times are as many as there are times.
    """
    _check_steps(steps)
    count = len(alphas_cumprod)
    wanted = min(steps, count)
    times = np.rint(count * (1.0 - np.arange(wanted) / wanted)).astype(int) - 1
    kept = alphas_cumprod[times]
    if not ((kept > 0) & (kept < 1)).all():
        raise SettingProblem(
            "the signal's share must lie between 0 and 1 at every time: at 0 nothing is left to denoise"
        )
    return np.append(np.sqrt((1 - kept) / kept), 0.0), tuple(int(t) for t in times)


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
    """The sample that grows from `noise` (standard normal, any shape) along falling noise `levels`, the last of them 0.

    `most_degree` holds the polynomial down, 0 = a constant (see `guidance.plan`). Cancelled between any two passes.
    """
    steps = len(levels) - 1
    predicts, corrects = (min(degree, max_degree) for degree in _degrees(solver, steps))
    x = start = noise * float(levels[0])
    seen: list[tuple[float, Any]] = []
    kept: list[SamplerStep] = []
    for index in range(steps):
        sigma = float(levels[index])
        progress.step(index / steps, f"step {index + 1} of {steps}")
        clean = denoise(x, sigma)
        here = -math.log(sigma)
        if corrects and seen:
            before = seen[-1][0]
            x = _advanced(start, (*seen[-corrects:], (here, clean)), before, here - before)
        seen = [*seen[-2:], (here, clean)]
        if keep_steps:
            kept.append(SamplerStep(sigma=sigma, noisy=x, clean=clean))
        if levels[index + 1] <= 0.0:
            break
        start = x
        x = _advanced(start, seen[-1 - predicts :], here, -math.log(float(levels[index + 1])) - here)
    progress.step(1.0, "sampled")
    return SamplerResult(clean=seen[-1][1], passes=steps, steps=tuple(kept))


def _degrees(solver: Solver, steps: int) -> tuple[int, int]:
    """Of the polynomial that predicts, and of the one that corrects (0: none does)."""
    if solver == "ddim":
        return 0, 0
    if solver == "dpmpp_2m":
        return 1, 0
    return (0, 1) if steps < _FEW else (1, 1) if steps < _SOME else (2, 2)


def _advanced(x: Any, seen: Sequence[tuple[float, Any]], begin: float, by: float) -> Any:
    """The noisy array a step `by` of lambda on, with D as the polynomial through `seen`."""
    moved = x * math.exp(-by)
    for share, (_, clean) in zip(_shares([place - begin for place, _ in seen], by), seen, strict=True):
        moved = moved + clean * share
    return moved


def _shares(places: Sequence[float], by: float) -> list[float]:
    """Integral from 0 to `by` of e^-(by - tau) times each Lagrange polynomial of `places`."""
    nodes, weights = _gauss()
    low = math.exp(-by)
    passed = 0.5 * (1 - low) * nodes + 0.5 * (1 + low)  # e^-(by - tau), in which the rest is smooth
    tau = by + np.log(passed)
    found: list[float] = []
    for j, own in enumerate(places):
        basis = np.ones_like(tau)
        for m, other in enumerate(places):
            if m != j:
                basis = basis * (tau - other) / (own - other)
        found.append(float(0.5 * (1 - low) * (weights * basis).sum()))
    return found


@cache
def _gauss() -> tuple[Doubles, Doubles]:
    nodes, weights = np.polynomial.legendre.leggauss(12)
    return nodes, weights


def _check_steps(steps: int) -> None:
    if not 1 <= steps <= MAX_STEPS:
        raise SettingProblem(f"the number of denoising steps must lie between 1 and {MAX_STEPS}, got {steps}")
