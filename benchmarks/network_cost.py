"""What do precision, layout and the contact's box save of a network's time, and what do they cost?

    python benchmarks/network_cost.py

A step of the compact U-Net: in 16 bits beside 32, pixels or channels innermost; the error is how far its gradient is
off the one in 32 bits, as a share of it. Depth Anything V2, small, on a GelSlim's picture at 224 x 294: all of its
patches beside those around a contact of a third of each side. Times follow the patches; how far a box's answer is off
that of all patches no random weights can tell, and none are shipped, so that no error stands there.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.timing import Requirement, build_measurement, time_in_turns
from pipeline.networks.compact_unet import CompactUnet
from pipeline.networks.depth_anything import DepthAnything
from pipeline.networks.network_factory import build_network, use_channels_last
from pipeline.racing.results import BenchmarkResult
from pipeline.racing.text_report import print_result
from pipeline.stages.touch.latent_diffusion import LatentParams, sample_image
from pipeline.training.distributed import wrap_precision
from pipeline.training.recipe import load_recipe

_BATCH, _CHANNELS, _SHAPE = 8, 12, (120, 160)
_PATCHES, _WINDOW = (16, 21), (3, 5, 10, 11)  # top, left, rows, cols: a third of each side, and two patches around
_RUNS = 5
_STEPS, _SAMPLES = 200, 3


def build_gradient_step(precision: str, *, channels_last: bool):
    """A call that works out the gradient of one step, and gives it."""
    torch.manual_seed(0)
    net = CompactUnet(inputs=_CHANNELS, outputs=3).train()
    picture, truth = torch.randn(_BATCH, _CHANNELS, *_SHAPE), torch.randn(_BATCH, 3, *_SHAPE)
    if channels_last:
        net, picture = net.to(memory_format=torch.channels_last), picture.to(memory_format=torch.channels_last)
    learns = wrap_precision(net, precision, torch.device("cpu"))

    def step():
        net.zero_grad()
        (learns(picture) - truth).square().mean().backward()
        return torch.cat([p.grad.flatten() for p in net.parameters()])

    return step


def training_rows():
    steps = {f"{precision}, {layout} innermost": build_gradient_step(precision, channels_last=layout == "channels")
             for precision in ("float32", "bf16") for layout in ("pixels", "channels")}  # fmt: skip
    plain = "float32, pixels innermost"
    exact = steps[plain]()
    errors = {name: float((step() - exact).norm() / exact.norm()) for name, step in steps.items()}
    times = time_in_turns(steps, runs=_RUNS)
    return [
        build_measurement(f"a training step of the compact U-Net, {_BATCH} of {_SHAPE[0]} x {_SHAPE[1]}: {name}", ours=times[name],
            ours_error=errors[name], unit="of the gradient", peer=plain, peer_timing=times[plain], bar=Requirement())
        for name in steps if name != plain
    ]  # fmt: skip


def box_rows():
    torch.manual_seed(0)
    net = DepthAnything(encoder="vits").eval()
    picture = torch.rand(1, 3, 14 * _PATCHES[0], 14 * _PATCHES[1])
    top, left, rows, cols = _WINDOW
    part = picture[..., 14 * top : 14 * (top + rows), 14 * left : 14 * (left + cols)].contiguous()
    whole = (top, left, *_PATCHES)
    with torch.inference_mode():
        times = time_in_turns({"all": lambda: net(picture), "box": lambda: net(part, whole)}, runs=_RUNS)
    told = f"Depth Anything V2, small: {rows * cols} of {_PATCHES[0] * _PATCHES[1]} patches"
    return [build_measurement(told, ours=times["box"], ours_error=float("nan"), unit="", peer="all patches",
                peer_timing=times["all"], bar=Requirement(min_speedup=2.0))]  # fmt: skip


def latent_rows():
    told = load_recipe("latent", "latent").network
    net = use_channels_last(
        build_network("latent", {name: value for name, value in told.items() if name != "kind"})
    ).eval()
    shown = np.random.default_rng(0).normal(size=(3, net.side, net.side)).astype(np.float32)
    time = torch.tensor([500])
    with torch.inference_mode():
        seen = net.cond_stage_model(torch.from_numpy(shown[None]))
        noisy = torch.randn(1, 4, *seen.shape[2:])

        def apart():
            for told in (seen, torch.zeros_like(seen)) * _STEPS:
                net.noise(noisy, time, told)

        runs = {"ours": lambda: sample_image(net, shown, LatentParams(steps=_STEPS)), "apart": apart}
        times = time_in_turns(runs, runs=_SAMPLES)
    return [build_measurement(f"latent diffusion, a touch of {_STEPS} steps, guided", ours=times["ours"], ours_error=float("nan"),
                unit="", peer="its passes alone, one after the other", peer_timing=times["apart"],
                bar=Requirement(max_ms=5000.0))]  # fmt: skip


def measure() -> BenchmarkResult:
    return BenchmarkResult(
        title="What precision, layout and the contact's box save of a network's time",
        unit="of the gradient",
        rows=(*training_rows(), *box_rows(), *latent_rows()),
        notes=("random weights: the times are those of learned ones, the box's error is not known",),
    )


if __name__ == "__main__":
    print_result(measure())
