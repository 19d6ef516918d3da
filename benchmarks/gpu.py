"""How long does a lab-sized network take on a graphics card, and how near is it to the processor?

    python -m benchmarks.gpu

The published configuration (295 million parameters, random weights), one guided frame; bfloat16 on
the card. The error is the mean difference to the processor in float32 after two steps, as a share
of the range.
"""

from __future__ import annotations

import time

import numpy as np
import torch

from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, summarize_times
from pipeline.core.arrays import Floats
from pipeline.stages.networks.devices import PROCESSOR, check_device
from pipeline.stages.networks.latent_diffusion import LatentDiffusion
from pipeline.stages.networks.network_factory import load_network
from pipeline.stages.networks.weights import Weights
from pipeline.stages.touch.latent_diffusion import LatentParams, sample_image

NEEDS = "a graphics card"
_CARD = "cuda bfloat16"
_GUIDANCE = 2.0
_COMPARED_STEPS = 2  # the processor takes some seconds for each
_N_RUNS = 3
_BARS_MS = {200: 6000.0, 20: 800.0}  # steps -> on an H100


def measure() -> BenchmarkResult:
    check_device("cuda")
    torch.manual_seed(0)
    tensors = {name: t.numpy().copy() for name, t in LatentDiffusion().state_dict().items()}
    weights = Weights(name="published", kind="latent", config={}, tensors=tensors)
    side = LatentDiffusion().side
    condition = np.random.default_rng(0).standard_normal((3, side, side)).astype(np.float32)

    def sample(placement: str, steps: int) -> Floats:
        params = LatentParams(steps=steps, guidance=_GUIDANCE)
        return sample_image(load_network(weights.place(placement)), condition, params)[0]

    exact, there = (sample(placement, _COMPARED_STEPS) for placement in (PROCESSOR, _CARD))
    error = float(np.abs(exact - there).mean() / np.ptp(exact))
    rows = []
    for steps, bar_ms in _BARS_MS.items():
        taken_ms = []
        for _ in range(_N_RUNS):
            started = time.perf_counter()
            sample(_CARD, steps)
            taken_ms.append(1e3 * (time.perf_counter() - started))
        rows.append(
            build_measurement(
                f"latent T2T, {steps} guided steps, one frame",
                ours=summarize_times(taken_ms),
                ours_error=error,
                unit="of the range",
                bar=Requirement(max_ms=bar_ms, max_error=0.02),
            )
        )
    name = torch.cuda.get_device_name()
    return BenchmarkResult(
        title="Graphics card", unit="of the range", rows=tuple(rows), notes=(name,)
    )


if __name__ == "__main__":
    print_result(measure())
