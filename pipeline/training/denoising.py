"""How a denoiser learns a residual: noise of all strengths, the strongest most often, and conditions left out at times.

At the strongest noise nothing is left to see but the condition, and nothing is shown (zero terminal signal, Lin et al.
2024): the answer there is the posterior's middle, which one step gives. There errors count as squares where they are
small and by themselves where they are large (Huber), so that a body which is rarely there draws the middle less than
one which mostly is. Through less noise they count as squares alone: samples follow the mean of what is possible, and
come out all alike where they follow its median. What a gel's picture shows are slopes: errors of theirs count as
squares, so that one step gives the middle of all pictures, without edges whose place is not known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.base.params import setting
from pipeline.networks.samplers import make_sigma_schedule, sample
from pipeline.sensors.spec import load_sensor
from pipeline.stages.touch.confidence_weighting import compute_wiener_gain
from pipeline.stages.touch.residual_diffusion import LOG_ERROR_RANGE
from pipeline.training.distributed import unwrap_network

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.task import Example

_AT_MOST = 0.5  # share of examples under the strongest noise, of which a network is shown nothing
_USUAL = 0.0, 1.5  # of the logarithm of all other noise, in units: mean and deviation
_DROPPED = 0.1  # share without a condition
_HUBER = 0.25  # units
_FEW = 6  # steps of the sample among the figures
TargetSensor = Literal["soft_bubble", "gelslim"]
RESIDUAL_SCALE_MM = {"bubble": 3.0, "gel": 0.2}  # of the residual: about its standard deviation where it is large


@dataclass(frozen=True, slots=True, kw_only=True)
class DenoisingTask:
    """What every task has whose network denoises a residual of the target's touch."""

    target: TargetSensor = setting("soft_bubble", "Target", choices=TargetSensor)
    contact_weight: float = setting(1.0, "Weight of the contact", low=0.0, high=100.0)
    slope_weight: float = setting(
        0.0, "Weight of the slopes", low=0.0, high=1000.0, help="of what a gel's picture shows"
    )
    uncertainty_only: bool = setting(
        False,
        "Doubt alone",
        help="of what a network says, learn only how far off it is: by touches held back",
    )

    @property
    def kind(self) -> Literal["bubble", "gel"]:
        """The target's."""
        return load_sensor(self.target).kind

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """See `denoising.loss` and `denoising.doubt`."""
        return (
            compute_uncertainty_loss(network, batch)
            if self.uncertainty_only
            else compute_denoising_loss(network, batch, self.contact_weight, self.slope_weight)
        )

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """See `denoising.figures`; what touch to touch begins with is the untouched target."""
        return evaluate_denoiser(network, held_out, RESIDUAL_SCALE_MM[self.kind])


def compute_denoising_loss(
    network: nn.Module, batch: Mapping[str, Tensor], near: float, slopes: float = 0.0
) -> tuple[Tensor, dict[str, Any]]:
    """The error of the clean residual and of the spread that is said of it.

    `near`: how much more contact counts; `slopes`: the weight of what differs from pixel to pixel.
    """
    import torch
    from torch.nn import functional

    from pipeline.networks.smooth_noise import correlate_noise

    net = unwrap_network(network)
    clean, condition = batch["residual"], batch["condition"]
    n = len(clean)
    level = torch.exp(torch.empty(n).normal_(*_USUAL)).clamp(net.sigma_min, 0.999 * net.sigma_max)
    hidden = torch.rand(n) < _AT_MOST
    sigma = torch.where(hidden, torch.full((n,), float(net.sigma_max)), level).to(clean.device)
    kept = (torch.rand(n) >= _DROPPED).to(clean.device).float().reshape(-1, 1, 1, 1)
    noisy = clean + sigma.reshape(-1, 1, 1, 1) * correlate_noise(torch.randn_like(clean), net.noise_correlation)
    said = network(noisy, sigma, condition * kept)
    off, wrong = said[:, 0] - clean[:, 0], said[:, 1] - clean[:, 1]
    weight = 1.0 + near * batch["contact"][:, 0]
    fine = ((1.0 + sigma**2) / sigma**2).clamp(max=5.0).reshape(-1, 1, 1)
    robust = functional.huber_loss(off, torch.zeros_like(off), delta=_HUBER, reduction="none") / _HUBER
    squared = 0.5 * off**2 * fine
    residual = (torch.where(hidden.to(off.device).reshape(-1, 1, 1), robust, squared) * weight).mean()
    contact = (wrong**2 * fine).mean()
    spread = _unlikely(said, off)
    parts = {"residual": residual, "contact": contact, "spread": spread}
    total = residual + 0.5 * contact + 0.05 * spread
    if slopes > 0.0:
        parts["slopes"] = sum(off.diff(dim=axis).square().mean() for axis in (-1, -2))
        total = total + slopes * parts["slopes"]
    return total, {name: part.detach() for name, part in parts.items()}


def compute_uncertainty_loss(network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
    """How unlikely one step's errors are by what is told of them: for a recipe whose `factors` hold all else still.

    What knows its touches by heart is right about them and tells so; only on others it learns how far off it is.
    """
    import torch

    net = unwrap_network(network)
    net.eval()  # norms stay as they were learned
    clean = batch["residual"]
    sigma = torch.full((len(clean),), float(net.sigma_max), device=clean.device)
    said = network(torch.zeros_like(clean), sigma, batch["condition"])
    spread = _unlikely(said, said[:, 0] - clean[:, 0])
    return spread, {"spread": spread.detach()}


def _unlikely(said: Tensor, off: Tensor) -> Tensor:
    """How unlikely errors `off` (n, rows, cols) are by the log of their mean that `said` tells (Laplace)."""
    log = said[:, 2].clamp(*LOG_ERROR_RANGE)
    return (off.detach().abs() * (-log).exp() + log).mean()


def evaluate_denoiser(network: nn.Module, held_out: Sequence[Example], unit_mm: float) -> dict[str, float]:
    """Errors in mm in the target's contact and over all, and overlap of contact, of four answers.

    One step, a sample, one step that is held back where it is unsure, and what all of them are added to. Another
    sample lies as far from the first as the truth does, if both are what the condition allows.
    """
    import torch

    from pipeline.networks.smooth_noise import correlate_noise

    net = unwrap_network(network)
    rows: list[list[float]] = []
    for k, example in enumerate(held_out):
        condition = torch.from_numpy(np.array(example["condition"]))[None]
        rng = torch.Generator().manual_seed(k)
        noises = [
            correlate_noise(torch.randn((1, *example["residual"].shape), generator=rng), net.noise_correlation)
            for _ in range(2)
        ]

        def denoise(noisy: Tensor, sigma: float, condition: Tensor = condition) -> Tensor:
            return network(noisy, torch.full((1,), sigma), condition)[:, :2]

        with torch.inference_mode():
            first = network(noises[0] * net.sigma_max, torch.full((1,), float(net.sigma_max)), condition)[0].numpy()
            levels = make_sigma_schedule(_FEW, sigma_max=net.sigma_max, sigma_min=net.sigma_min)
            drawn, other = (sample(denoise, noise, levels).clean[0].numpy() for noise in noises)
        held = first[0] * compute_wiener_gain(first[0], np.exp(np.clip(first[2], *LOG_ERROR_RANGE)))
        mm, touched = unit_mm * example["residual"][0], example["contact"][0] > 0
        base, right = example["contact"][1], example["contact"][0]
        found = ((first[0], first[1]), (drawn[0], drawn[1]), (held, first[1]), (0.0 * first[0], 0.0 * first[1]))
        rows.append([])
        for field, change in found:
            off, contact = np.abs(unit_mm * field - mm), base + change > 0.5
            both = np.count_nonzero(contact | touched)
            overlap = np.count_nonzero(contact & touched) / max(both, 1)
            rows[-1] += [float(off[touched].mean()) if right.any() else 0.0, float(off.mean()), overlap]
        apart = unit_mm * np.abs(drawn[0] - other[0])
        rows[-1] += [float(apart[touched].mean()) if right.any() else 0.0, float(apart.mean())]
    names = [f"{who}{what}" for who in ("", "sample ", "held back ", "none of it ")
             for what in ("in contact, mm", "over all, mm", "contact, IoU")]  # fmt: skip
    names += ["two samples apart in contact, mm", "two samples apart over all, mm"]
    return dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True))
