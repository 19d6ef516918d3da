"""Base of the tasks that train a denoiser, with its losses and metrics.

At the largest noise level the network sees the condition alone (zero terminal signal, Lin et al.
2024), and one step gives the posterior mean. Errors count there as squares where they are small and
linearly where they are large (Huber), so that a body which is rarely present moves the mean less.
At smaller noise levels they count as squares: samples then follow the mean of what is possible,
while those trained toward its median hardly differ. A gel's image shows slopes: squared errors of
slopes make one step the mean of all images, without edges at unknown positions.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.core.params import setting
from pipeline.lab.training.distributed import unwrap_network
from pipeline.lab.training.task import SimulatedPresses
from pipeline.stages.networks.samplers import make_sigma_schedule, sample
from pipeline.stages.networks.touch_formats import get_touch_format
from pipeline.stages.touch.confidence_weighting import compute_wiener_gain
from pipeline.stages.touch.residual_diffusion import LOG_ERROR_RANGE

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.lab.training.task import Example

_TERMINAL_SHARE = 0.5  # examples at the largest noise level
_LOG_SIGMA = 0.0, 1.5  # mean and standard deviation of the logarithm of all other noise levels
_CONDITION_DROPOUT = 0.1
_HUBER = 0.25  # in units of the residual
# weights in the loss
_CONTACT_TERM = 0.5
_UNCERTAINTY_TERM = 0.05
_N_SAMPLE_STEPS = 6  # of the samples in the metrics
TargetSensor = Literal["soft_bubble", "gelslim"]


@dataclass(frozen=True, slots=True, kw_only=True)
class DenoisingTask(SimulatedPresses):
    """Settings of every task whose network denoises a residual of the target's touch."""

    contact_weight: float = setting(1.0, "Contact weight", low=0.0, high=100.0)
    slope_weight: float = setting(
        0.0, "Slope weight", low=0.0, high=1000.0, help="of the slopes a gel's image shows"
    )
    uncertainty_only: bool = setting(
        False,
        "Uncertainty only",
        help="trains the predicted error alone, on touches that nothing else was trained on",
    )

    @property
    @abstractmethod
    def kind(self) -> str:
        """Kind of the target."""

    def compute_loss(
        self, network: nn.Module, batch: Mapping[str, Tensor]
    ) -> tuple[Tensor, dict[str, Any]]:
        """See `compute_denoising_loss` and `compute_uncertainty_loss`."""
        if self.uncertainty_only:
            return compute_uncertainty_loss(network, batch)
        return compute_denoising_loss(network, batch, self.contact_weight, self.slope_weight)

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """See `evaluate_denoiser`; the baseline of touch to touch is the untouched target."""
        return evaluate_denoiser(network, held_out, get_touch_format(self.kind).residual_unit_mm)


def compute_denoising_loss(
    network: nn.Module,
    batch: Mapping[str, Tensor],
    contact_weight: float,
    slope_weight: float = 0.0,
) -> tuple[Tensor, dict[str, Any]]:
    """Error of the clean residual, and likelihood of the predicted uncertainty.

    `contact_weight`: additional weight of the residual in contact. `slope_weight`: weight of
    squared differences between neighbouring pixels' errors.
    """
    import torch
    from torch.nn import functional

    from pipeline.stages.networks.smooth_noise import correlate_noise

    net = unwrap_network(network)
    clean = batch["residual"]
    condition = batch["condition"][:, : net.inputs]  # older weights know no placement
    n = len(clean)
    level = torch.exp(torch.empty(n).normal_(*_LOG_SIGMA)).clamp(
        net.sigma_min, 0.999 * net.sigma_max
    )
    terminal = torch.rand(n) < _TERMINAL_SHARE
    sigma = torch.where(terminal, torch.full((n,), float(net.sigma_max)), level).to(clean.device)
    kept = (torch.rand(n) >= _CONDITION_DROPOUT).to(clean.device).float().reshape(-1, 1, 1, 1)
    noise = correlate_noise(torch.randn_like(clean), net.noise_correlation)
    prediction = network(clean + sigma.reshape(-1, 1, 1, 1) * noise, sigma, condition * kept)
    error = prediction[:, 0] - clean[:, 0]
    contact_error = prediction[:, 1] - clean[:, 1]
    weight = 1.0 + contact_weight * batch["contact"][:, 0]
    level_weight = ((1.0 + sigma**2) / sigma**2).clamp(max=5.0).reshape(-1, 1, 1)
    robust = (
        functional.huber_loss(error, torch.zeros_like(error), delta=_HUBER, reduction="none")
        / _HUBER
    )
    squared = 0.5 * error**2 * level_weight
    residual = (
        torch.where(terminal.to(error.device).reshape(-1, 1, 1), robust, squared) * weight
    ).mean()
    contact = (contact_error**2 * level_weight).mean()
    spread = _compute_laplace_loss(prediction, error)
    terms = {"residual": residual, "contact": contact, "spread": spread}
    total = residual + _CONTACT_TERM * contact + _UNCERTAINTY_TERM * spread
    if slope_weight > 0.0:
        terms["slopes"] = sum(error.diff(dim=axis).square().mean() for axis in (-1, -2))
        total = total + slope_weight * terms["slopes"]
    return total, {name: term.detach() for name, term in terms.items()}


def compute_uncertainty_loss(
    network: nn.Module, batch: Mapping[str, Tensor]
) -> tuple[Tensor, dict[str, Any]]:
    """Negative log-likelihood of one step's errors under the predicted uncertainty.

    For recipes whose `rate_factors` freeze all other parameters. A network is right about touches
    it was trained on; only other touches show how large its errors are.
    """
    import torch

    net = unwrap_network(network)
    net.eval()  # normalisation statistics stay
    clean = batch["residual"]
    sigma = torch.full((len(clean),), float(net.sigma_max), device=clean.device)
    prediction = network(torch.zeros_like(clean), sigma, batch["condition"][:, : net.inputs])
    spread = _compute_laplace_loss(prediction, prediction[:, 0] - clean[:, 0])
    return spread, {"spread": spread.detach()}


def _compute_laplace_loss(prediction: Tensor, error: Tensor) -> Tensor:
    """Negative log-likelihood of errors (n, rows, cols), Laplace.

    Channel 2 predicts the log of their mean.
    """
    log = prediction[:, 2].clamp(*LOG_ERROR_RANGE)
    return (error.detach().abs() * (-log).exp() + log).mean()


def evaluate_denoiser(
    network: nn.Module, held_out: Sequence[Example], unit_mm: float
) -> dict[str, float]:
    """Errors in mm, in the target's contact and over all, and contact IoU of four predictions.

    They are one step, a sample, one step with confidence weighting, and no prediction. Two samples
    differ by as much as a sample and the truth if both follow the distribution that the condition
    allows.
    """
    import torch

    from pipeline.stages.networks.smooth_noise import correlate_noise

    net = unwrap_network(network)
    rows: list[list[float]] = []
    for k, example in enumerate(held_out):
        condition = torch.from_numpy(np.array(example["condition"]))[None, : net.inputs]
        rng = torch.Generator().manual_seed(k)
        noises = [
            correlate_noise(
                torch.randn((1, *example["residual"].shape), generator=rng), net.noise_correlation
            )
            for _ in range(2)
        ]

        def denoise(noisy: Tensor, sigma: float, condition: Tensor = condition) -> Tensor:
            return network(noisy, torch.full((1,), sigma), condition)[:, :2]

        with torch.inference_mode():
            first = network(
                noises[0] * net.sigma_max, torch.full((1,), float(net.sigma_max)), condition
            )[0].numpy()
            levels = make_sigma_schedule(
                _N_SAMPLE_STEPS, sigma_max=net.sigma_max, sigma_min=net.sigma_min
            )
            one, other = (sample(denoise, noise, levels).clean[0].numpy() for noise in noises)
        weighted = first[0] * compute_wiener_gain(
            first[0], np.exp(np.clip(first[2], *LOG_ERROR_RANGE))
        )
        truth = unit_mm * example["residual"][0]
        has_contact = example["contact"][0] > 0
        baseline = example["contact"][1]
        predictions = (
            (first[0], first[1]),
            (one[0], one[1]),
            (weighted, first[1]),
            (0.0 * first[0], 0.0 * first[1]),
        )
        rows.append([])
        for field, change in predictions:
            error = np.abs(unit_mm * field - truth)
            contact = baseline + change > 0.5
            union = np.count_nonzero(contact | has_contact)
            iou = np.count_nonzero(contact & has_contact) / max(union, 1)
            rows[-1] += [
                float(error[has_contact].mean()) if has_contact.any() else 0.0,
                float(error.mean()),
                iou,
            ]
        apart = unit_mm * np.abs(one[0] - other[0])
        rows[-1] += [
            float(apart[has_contact].mean()) if has_contact.any() else 0.0,
            float(apart.mean()),
        ]
    names = [
        f"{which}{what}"
        for which in ("", "sample ", "confidence-weighted ", "no-prediction ")
        for what in ("error in contact, mm", "error over all, mm", "contact IoU")
    ]
    names += ["difference of two samples in contact, mm", "difference of two samples over all, mm"]
    return dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True))
