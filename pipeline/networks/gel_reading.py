"""The network that reads a gel: slopes, the surface they integrate to, contact, and how sure it is.

What a picture tells at a place is a slope; a convolution tells slopes well and heights badly, as those depend on what
is far away. So the U-Net tells slopes (gx, gy) and a rough surface z0, and the surface is the one nearest to both,

    minimise  sum |D z - g|^2 + (z - z0)^2 / reach^2,

solved exactly by a cosine transform (two products with a matrix), which gradients pass through. The slopes are those
that the described light would make of the picture, times a factor from 0 to 7, and more: what is learned is where the
description is wrong, by how much, and what is no slope at all (dots, drift, shadows).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from pipeline.networks.compact_unet import CompactUnet

_ROUGH_PX = 4.0  # brings the rough surface to the order of 1


class Reading(NamedTuple):
    """Each (n, rows, cols) float32; lengths in pixels. A tuple, as networks that learn on several devices answer."""

    surface: Tensor  # pushed in, positive toward the camera
    rough: Tensor  # z0 of the formula
    slope_x: Tensor
    slope_y: Tensor
    contact: Tensor  # logit
    log_spread: Tensor  # logarithm of the Laplace scale of `surface`


class GelReading(nn.Module):
    """Reads fields (n, inputs, rows, cols)."""

    def __init__(
        self,
        *,
        inputs: int,
        hint: int,
        first: int = 32,
        levels: int = 4,
        widest: int = 120,
        reach_px: float = 60.0,
    ) -> None:
        """`hint`: the first of two inputs that are slopes by the described light, right and down."""
        super().__init__()
        self.hint = hint
        self.body = CompactUnet(inputs=inputs, outputs=6, first=first, levels=levels, widest=widest)
        self.reach_px = reach_px

    def forward(self, fields: Tensor) -> Reading:
        """What the fields show."""
        fields = fields.contiguous(memory_format=torch.channels_last)  # a third of the time less
        rough, more_x, more_y, factor, contact, log_spread = self.body(fields).float().unbind(1)
        rough, factor = _ROUGH_PX * rough, torch.exp(0.5 * factor.clamp(-8.0, 4.0))
        slope_x = factor * fields[:, self.hint] + more_x
        slope_y = factor * fields[:, self.hint + 1] + more_y
        with torch.autocast(fields.device.type, enabled=False):
            surface = integrated(slope_x, slope_y, rough, self.reach_px)
        return Reading(surface=surface, rough=rough, slope_x=slope_x, slope_y=slope_y, contact=contact,
                       log_spread=log_spread.clamp(-6.0, 3.0))  # fmt: skip


def integrated(slope_x: Tensor, slope_y: Tensor, rough: Tensor, reach: float) -> Tensor:
    """The surface (n, rows, cols) nearest to slopes and, over lengths beyond `reach`, to a rough surface."""
    edges_x = 0.5 * (slope_x[..., 1:] + slope_x[..., :-1])
    edges_y = 0.5 * (slope_y[..., 1:, :] + slope_y[..., :-1, :])
    pull = 1.0 / reach**2
    right = functional.pad(edges_x, (1, 0)) - functional.pad(edges_x, (0, 1))
    right = right + functional.pad(edges_y, (0, 0, 1, 0)) - functional.pad(edges_y, (0, 0, 0, 1)) + pull * rough
    rows, cols = rough.shape[-2:]
    down, across, weight = _transform(rows), _transform(cols), _laplacian(rows, cols)
    wave = (down @ right @ across.T) / (weight + pull)
    return down.T @ wave @ across


@lru_cache(maxsize=16)
def _transform(n: int) -> Tensor:
    """The orthonormal cosine transform (n, n): row k is the wave k."""
    k, i = torch.arange(n, dtype=torch.float64)[:, None], torch.arange(n, dtype=torch.float64)[None, :]
    table = torch.cos(math.pi * (i + 0.5) * k / n) * math.sqrt(2.0 / n)
    table[0] *= math.sqrt(0.5)
    return table.float()


@lru_cache(maxsize=16)
def _laplacian(rows: int, cols: int) -> Tensor:
    """Eigenvalues (rows, cols) of D'D."""
    ky, kx = (2.0 * torch.sin(torch.arange(n, dtype=torch.float64) * (0.5 * math.pi / n)) for n in (rows, cols))
    return (ky[:, None] ** 2 + kx[None, :] ** 2).float()
