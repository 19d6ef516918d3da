"""The loss of pairs whose imprints are known but for their scale: how unlike the true one the expected imprint is.

Tiles are stretched each by itself, so that millimetres would teach the stretching. What counts is what a tile has
beside the mean imprint: a mean alone looks like every touch.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.training.distributed import unwrap_network

if TYPE_CHECKING:
    from torch import Tensor, nn

_SCALE, _HUBER = 0.1, 0.25  # share of the error in units, so that the scale stays about right; units
_TINY = 1e-6


def compute_correlation_loss(
    network: nn.Module, batch: Mapping[str, Tensor], mean: Floats, weight: float
) -> tuple[Tensor, dict[str, Any]]:
    """1 - partial correlation of one step's imprints with the true ones, the mean (rows, cols) regressed out."""
    import torch
    from torch.nn import functional

    net = unwrap_network(network)
    true, condition = batch["residual"], batch["condition"]
    sigma = torch.full((len(true),), float(net.sigma_max), device=true.device)
    said = network(torch.zeros_like(true), sigma, condition)[:, 0]
    common = torch.from_numpy(np.array(mean, np.float32)).to(true.device)
    common = common - common.mean()

    def regress_out_mean(field: Tensor) -> Tensor:
        centred = field - field.mean((1, 2), keepdim=True)
        share = (centred * common).sum((1, 2), keepdim=True) / common.square().sum().clamp(min=_TINY)
        return centred - share * common

    one, other = regress_out_mean(said), regress_out_mean(true[:, 0])
    sizes = one.square().sum((1, 2)) * other.square().sum((1, 2))
    unlike = (1.0 - (one * other).sum((1, 2)) / (sizes + _TINY).sqrt()).mean()
    off = functional.huber_loss(said, true[:, 0], delta=_HUBER) / _HUBER
    parts = {"unlike": unlike.detach(), "residual": off.detach()}
    return weight * unlike + _SCALE * off, parts
