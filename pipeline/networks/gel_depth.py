"""The network that corrects what physics reads of a gel: its slopes, the surface they integrate to, and its contact.

What a picture tells at a place is a slope; a convolution tells slopes well and heights badly, as those depend on what
is far away. So the U-Net tells by what the slopes of the physical surface z are off, (gx, gy), and roughly by how much
the surface itself is, d0, and the correction d is the surface nearest to both,

    minimise  sum |D d - g|^2 + (d - d0)^2 / reach^2,

solved exactly by a cosine transform (two products with a matrix), which gradients pass through. g is a share of the
slopes of z, and more: walls steeper than light can tell come out too low everywhere alike.

All heights are told in the depth of the physical contact, and what is added is bounded by a share of the height there.
How deep all of a touch is depends on how bright a unit's lamps are and on walls that light does not tell: a network
that is `scaled`, which has been shown what the light is like, tells a factor as well, the mean over the contact of what
its pixels make of it. A network that has learned nothing yet corrects nothing: its last layer begins at zero.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from pipeline.networks import gel_depth_opencv as light
from pipeline.networks.compact_unet import CompactUnet

PHYSICS_CONTACT_LOGIT = 2.0  # logit of what physics holds for contact


class GelDepthPrediction(NamedTuple):
    """Each (n, rows, cols) float32; heights in depths of the physical contact.

    A tuple, as networks that learn on several devices answer.
    """

    surface: Tensor  # pushed in, positive toward the camera: physics and its correction
    correction: Tensor
    contact_logit: Tensor  # logit
    contact_logit_correction: Tensor  # what of it is not physics'
    log_error_scale: (
        Tensor  # logarithm of the Laplace scale of `surface`, of its product with the factor if it is scaled
    )
    log_depth_factor: Tensor | None = (
        None  # (n,) logarithm of the factor that makes `surface` true; None: it is not told
    )


class GelDepthNetwork(nn.Module):
    """Reads fields (n, inputs, rows, cols)."""

    def __init__(
        self,
        *,
        inputs: int,
        physics_channel: int,
        base_channels: int = 32,
        levels: int = 4,
        max_channels: int = 120,
        reach_px: float = 25.0,
        calibrated: bool = False,
        predicts_depth_factor: bool = False,
    ) -> None:
        """`physical`: the first of four inputs by physics: slopes right and down, indentation, share in contact.

        `calibrated`: it has learned what a look-up of the very unit leaves, not what physics reads without one.
        `scaled`: it tells how deep all of a touch is, of units whose light is as described but for what units differ
        by (`stages.depth.light_fields`).
        """
        super().__init__()
        self.physics_channel, self.calibrated, self.predicts_depth_factor = physics_channel, calibrated, predicts_depth_factor
        self.body = CompactUnet(
            inputs=inputs,
            outputs=light.OUTPUTS + predicts_depth_factor,
            base_channels=base_channels,
            levels=levels,
            max_channels=max_channels,
        )
        for last in (self.body.finish.weight, self.body.finish.bias):
            assert last is not None
            nn.init.zeros_(last)
        self.reach_px = reach_px

    def forward(self, fields: Tensor) -> GelDepthPrediction:
        """What the fields show."""
        fields = fields.contiguous(memory_format=torch.channels_last)  # a third of the time less
        told = self.body(fields).float()
        rough, more_x, more_y, factor, more_contact, log_spread = told[:, : light.OUTPUTS].unbind(1)
        slope_x, slope_y, deep, pressed = fields[:, self.physics_channel : self.physics_channel + 4].unbind(1)
        share = torch.expm1(light.LOG_SHARE_SCALE * factor.clamp(light.LOG_SHARE_MIN, light.LOG_SHARE_MAX))
        with torch.autocast(fields.device.type, enabled=False):
            wanted = integrate_slopes(
                (share * slope_x + more_x) / light.SLOPE_UNIT_PX, (share * slope_y + more_y) / light.SLOPE_UNIT_PX,
                light.COARSE_SCALE * rough, self.reach_px,
            )  # fmt: skip
            most = light.MAX_CORRECTION + light.MAX_CORRECTION_SHARE * deep.clamp(0.0, 1.5)
            correction = most * torch.tanh(wanted / most)
        return GelDepthPrediction(
            surface=deep + correction, correction=correction,
            contact_logit=PHYSICS_CONTACT_LOGIT * (2.0 * pressed - 1.0) + more_contact, contact_logit_correction=more_contact,
            log_error_scale=log_spread.clamp(light.LOG_ERROR_MIN, light.LOG_ERROR_MAX),
            log_depth_factor=_over(pressed, told[:, light.OUTPUTS]) if self.predicts_depth_factor else None,
        )  # fmt: skip


def _over(pressed: Tensor, log_factor: Tensor) -> Tensor:
    """The factor's logarithm (n,), as the contact's pixels have it on the mean."""
    say = pressed.clamp(min=0.0) + light.NON_CONTACT_WEIGHT
    mean = (log_factor * say).sum(dim=(1, 2)) / say.sum(dim=(1, 2))
    return (light.LOG_FACTOR_SCALE * mean).clamp(-light.LOG_FACTOR_LIMIT, light.LOG_FACTOR_LIMIT)


def integrate_slopes(slope_x: Tensor, slope_y: Tensor, coarse: Tensor, reach_px: float) -> Tensor:
    """The surface (n, rows, cols) nearest to slopes and, over lengths beyond `reach`, to a rough surface."""
    edges_x = 0.5 * (slope_x[..., 1:] + slope_x[..., :-1])
    edges_y = 0.5 * (slope_y[..., 1:, :] + slope_y[..., :-1, :])
    pull = 1.0 / reach_px**2
    right = functional.pad(edges_x, (1, 0)) - functional.pad(edges_x, (0, 1))
    right = right + functional.pad(edges_y, (0, 0, 1, 0)) - functional.pad(edges_y, (0, 0, 0, 1)) + pull * coarse
    rows, cols = coarse.shape[-2:]
    down, across, weight = _transform(rows), _transform(cols), _laplacian(rows, cols)
    wave = (down @ right @ across.T) / (weight + pull)
    return down.T @ wave @ across


@lru_cache(maxsize=16)
def _transform(n: int) -> Tensor:
    """The orthonormal cosine transform (n, n): row k is the wave k."""
    with torch.inference_mode(False):  # whoever asks first: gradients pass through it later
        k, i = torch.arange(n, dtype=torch.float64)[:, None], torch.arange(n, dtype=torch.float64)[None, :]
        table = torch.cos(math.pi * (i + 0.5) * k / n) * math.sqrt(2.0 / n)
        table[0] *= math.sqrt(0.5)
        return table.float()


@lru_cache(maxsize=16)
def _laplacian(rows: int, cols: int) -> Tensor:
    """Eigenvalues (rows, cols) of D'D."""
    with torch.inference_mode(False):
        ky, kx = (2.0 * torch.sin(torch.arange(n, dtype=torch.float64) * (0.5 * math.pi / n)) for n in (rows, cols))
        return (ky[:, None] ** 2 + kx[None, :] ** 2).float()
