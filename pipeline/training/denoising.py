"""How a denoiser learns a residual: noise of all strengths, the strongest most often, and conditions left out at times.

At the strongest noise nothing is left to see but the condition, and nothing is shown: the answer there is the
posterior's middle, which one step gives. That noise is strong indeed, since a smooth residual is seen through hundreds
of pixels at once: at eight times the residual its mean is still plain (zero terminal signal, Lin et al. 2024). Errors
count as squares where they are small and by themselves where they are large (Huber), so that a body which is rarely
there draws the middle less than one which mostly is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.networks.samplers import sample, sigmas
from pipeline.stages.generate.diffusion import LOG_SPREAD, taken

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.task import Example

MOST, LEAST = 200.0, 0.02  # of the noise, in units; as the networks are built
_AT_MOST = 0.65  # share of examples under the strongest noise, of which a network is shown nothing
_DROPPED = 0.1  # share without a condition
_HUBER = 0.25  # units
_FEW = 6  # steps of the sample among the figures


def loss(network: nn.Module, batch: Mapping[str, Tensor], near: float) -> tuple[Tensor, dict[str, Any]]:
    """The error of the clean residual and of the spread that is said of it; `near`: how much more contact counts."""
    import torch
    from torch.nn import functional

    clean, condition = batch["residual"], batch["condition"]
    n = len(clean)
    level = torch.exp(torch.empty(n).uniform_(np.log(LEAST), np.log(MOST)))
    hidden = torch.rand(n) < _AT_MOST
    sigma = torch.where(hidden, torch.full((n,), MOST), level).to(clean.device)
    kept = (torch.rand(n) >= _DROPPED).to(clean.device).float().reshape(-1, 1, 1, 1)
    noisy = clean + sigma.reshape(-1, 1, 1, 1) * torch.randn_like(clean)
    said = network(noisy, sigma, condition * kept)
    off, wrong = said[:, 0] - clean[:, 0], said[:, 1] - clean[:, 1]
    weight = 1.0 + near * batch["contact"][:, 0]
    fine = ((1.0 + sigma**2) / sigma**2).clamp(max=5.0).reshape(-1, 1, 1)
    residual = (
        functional.huber_loss(off, torch.zeros_like(off), delta=_HUBER, reduction="none") * weight * fine
    ).mean()
    contact = (wrong**2 * fine).mean()
    log = said[:, 2].clamp(*LOG_SPREAD)
    spread = (off.detach().abs() * torch.exp(-log) + log).mean()
    parts = {"residual": residual, "contact": contact, "spread": spread}
    total = residual / _HUBER + 0.5 * contact + 0.05 * spread
    return total, {name: part.detach() for name, part in parts.items()}


def figures(network: nn.Module, held_out: Sequence[Example], unit_mm: float) -> dict[str, float]:
    """Errors in mm in the target's contact and over all, and overlap of contact, of four answers.

    One step, a sample, one step that is held back where it is unsure, and the physics that all begin with.
    """
    import torch

    rows: list[list[float]] = []
    for k, example in enumerate(held_out):
        condition = torch.from_numpy(np.array(example["condition"]))[None]
        noise = torch.randn((1, *example["residual"].shape), generator=torch.Generator().manual_seed(k))

        def denoise(noisy: Tensor, sigma: float, condition: Tensor = condition) -> Tensor:
            return network(noisy, torch.full((1,), sigma), condition)[:, :2]

        with torch.inference_mode():
            first = network(noise * MOST, torch.full((1,), MOST), condition)[0].numpy()
            drawn = sample(denoise, noise, sigmas(_FEW, most=MOST, least=LEAST)).clean[0].numpy()
        held = first[0] * taken(first[0], np.exp(np.clip(first[2], *LOG_SPREAD)), 1.0)
        mm, touched = unit_mm * example["residual"][0], example["contact"][0] > 0
        base, right = example["contact"][1], example["contact"][0]
        found = ((first[0], first[1]), (drawn[0], drawn[1]), (held, first[1]), (0.0 * first[0], 0.0 * first[1]))
        rows.append([])
        for field, change in found:
            off, contact = np.abs(unit_mm * field - mm), base + change > 0.5
            both = np.count_nonzero(contact | touched)
            overlap = np.count_nonzero(contact & touched) / max(both, 1)
            rows[-1] += [float(off[touched].mean()) if right.any() else 0.0, float(off.mean()), overlap]
    names = [f"{who}{what}" for who in ("", "sample ", "held back ", "physics ")
             for what in ("in contact, mm", "over all, mm", "contact, IoU")]  # fmt: skip
    return dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True))
