"""How few denoising steps do? The corrected solver next to DDIM and DPM-Solver++ 2M, on data whose
denoiser is known.

    python -m benchmarks.sampling

24 points in 32 dimensions with a spread around each, three of them picked by the condition (tests'
`mixtures`). The error is that of the end of the path, relative to a thousand fine steps on the same
noise. A pass of a network costs far more than the solver's own sums, so at the same number of steps
the baseline of each row is the better of the two.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.harness.results import BenchmarkResult, Measurement, PlotPoint
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, time_in_turns
from pipeline.stages.networks.samplers import Solver, make_sigma_schedule, sample
from tests.pipeline.stages.networks.mixtures import PICKED, denoiser, modes

STEPS = (5, 8, 10, 16, 25, 50)
_LEAST = 0.002
_SETTINGS = (  # name, scale of the points, spread, largest noise, weight of guidance
    ("broad", 1.0, 0.3, 80.0, 1.0),
    ("broad, guided", 1.0, 0.3, 80.0, 2.54),
    ("nearly determined", 1.0, 0.05, 80.0, 1.0),
    ("a residual", 0.1, 0.05, 1.0, 1.0),
    ("a residual, guided", 0.1, 0.05, 1.0, 2.54),
)


def measure() -> BenchmarkResult:
    rows: list[Measurement] = []
    points: list[PlotPoint] = []
    for name, scale, spread, most, weight in _SETTINGS:
        picked = denoiser(modes(scale)[:PICKED], spread)
        whole = denoiser(modes(scale), spread)

        def denoise(noisy, sigma, picked=picked, whole=whole, weight=weight):
            if weight == 1.0:
                return picked(noisy, sigma)
            away = whole(noisy, sigma)
            return away + weight * (picked(noisy, sigma) - away)

        noise = np.random.default_rng(1).normal(size=(200, modes().shape[1]))
        truth = sample(
            denoise, noise, make_sigma_schedule(1000, sigma_max=most, sigma_min=_LEAST)
        ).clean

        def run(solver: Solver, steps: int, denoise=denoise, noise=noise, most=most):
            return sample(
                denoise,
                noise,
                make_sigma_schedule(steps, sigma_max=most, sigma_min=_LEAST),
                solver=solver,
            ).clean

        for steps in STEPS:
            calls = {s: lambda s=s, n=steps: run(s, n) for s in ("ddim", "dpmpp_2m", "corrected")}
            error = {
                s: math.sqrt(((c() - truth) ** 2).mean() / (truth**2).mean())
                for s, c in calls.items()
            }
            times = time_in_turns(calls, runs=3)
            best = min(("ddim", "dpmpp_2m"), key=error.__getitem__)
            rows.append(
                build_measurement(
                    f"{name}: {steps} steps",
                    peer=f"the better of two, {best}",
                    ours=times["corrected"],
                    ours_error=error["corrected"],
                    peer_timing=times[best],
                    peer_error=error[best],
                    unit="of the data",
                    # no worse, but for a tenth where they are level
                    bar=Requirement(min_error_ratio=0.9),
                )
            )
            points += [
                PlotPoint(
                    method=f"{s}, {name}",
                    ms=times[s].median_ms,
                    error=error[s],
                    ours=s == "corrected",
                )
                for s in calls
            ]
    return BenchmarkResult(
        title="denoising steps", unit="of the data", rows=tuple(rows), points=tuple(points)
    )


if __name__ == "__main__":
    print_result(measure())
