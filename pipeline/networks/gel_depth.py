"""Network that corrects the physical depth of a gel: its slopes, the surface they integrate to, contact and scale.

An image shows slopes locally; heights depend on slopes far away, which a convolution predicts badly. So the U-Net
predicts a correction of the slopes of the physical surface, g = (gx, gy), and a rough correction d0 of the surface
itself, and the correction d of the surface is the least-squares solution of both,

    minimise  sum |D d - g|^2 + (d - d0)^2 / reach^2        (D: forward differences),

which a discrete cosine transform solves exactly (two matrix products; gradients pass through). g is a share of the
physical slopes plus an offset, since walls steeper than the light can show come out too shallow by a common factor.

Lengths are in units of the depth of the physical contact; the correction is bounded by a share of the local height.
The depth of the whole touch depends on how bright the LEDs of a sensor instance are and on walls that light does not
show, so the network also predicts one factor for it: the mean of a per-pixel output over the contact. The last layer is
initialised to zero: an untrained network corrects nothing.
"""

import math
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from pipeline.base.arrays import Doubles
from pipeline.networks.compact_unet import CompactUnet
from pipeline.networks.gel_depth_prediction import PHYSICS_CONTACT_LOGIT, GelDepthPrediction

N_OUTPUTS = 7
# Scales that bring the U-Net's outputs to the order of 1, and limits of what it predicts.
SLOPE_UNIT_PX = 8.0  # pixels per unit of slope
COARSE_SCALE = 0.25  # of the rough correction d0
CORRECTION_MAX, CORRECTION_SHARE_MAX = (
    0.08,
    0.35,
)  # |correction| is below the sum of CORRECTION_MAX and a share of the height
HEIGHT_MAX = 1.5  # heights count up to this in that bound
LOG_SHARE_SCALE, LOG_SHARE_MIN, LOG_SHARE_MAX = 0.5, -8.0, 4.0  # of log(1 + share of the physical slopes)
LOG_FACTOR_SCALE, LOG_FACTOR_LIMIT = 0.3, 1.0  # of the log of the depth factor
NON_CONTACT_WEIGHT = 1e-3  # of a pixel outside contact in the mean that gives the depth factor; 1 in contact
LOG_ERROR_MIN, LOG_ERROR_MAX = -6.0, 3.0


class GelDepthNetwork(nn.Module):
    """`GelDepthPrediction` from channels (n, inputs, rows, cols)."""

    onnx_size = (120, 160)  # (rows, cols) for which it is exported: the cosine transforms are constants of that size

    def __init__(
        self, *, inputs: int, physics_channel: int, base_channels: int = 32, levels: int = 4, max_channels: int = 120,
        reach_px: float = 25.0,
    ) -> None:  # fmt: skip
        """`physics_channel`: first of four physical channels (slope right, slope down, indentation, contact share)."""
        super().__init__()
        self.physics_channel, self.reach_px = physics_channel, reach_px
        self.body = CompactUnet(
            inputs=inputs, outputs=N_OUTPUTS, base_channels=base_channels, levels=levels, max_channels=max_channels
        )
        for last in (self.body.finish.weight, self.body.finish.bias):
            assert last is not None
            nn.init.zeros_(last)

    def forward(self, channels: Tensor) -> GelDepthPrediction:
        """The corrected surface, contact, error and depth factor of a batch."""
        channels = channels.contiguous(memory_format=torch.channels_last)  # a third less time
        rough, offset_x, offset_y, log_share, logit, log_error, log_factor = self.body(channels).float().unbind(1)
        slope_x, slope_y, height, contact = channels[:, self.physics_channel : self.physics_channel + 4].unbind(1)
        share = torch.exp(LOG_SHARE_SCALE * log_share.clamp(LOG_SHARE_MIN, LOG_SHARE_MAX)) - 1.0
        with torch.autocast(channels.device.type, enabled=False):
            unbounded = integrate_slopes(
                (share * slope_x + offset_x) / SLOPE_UNIT_PX, (share * slope_y + offset_y) / SLOPE_UNIT_PX,
                COARSE_SCALE * rough, self.reach_px,
            )  # fmt: skip
            limit = CORRECTION_MAX + CORRECTION_SHARE_MAX * height.clamp(0.0, HEIGHT_MAX)
            correction = limit * torch.tanh(unbounded / limit)
        return GelDepthPrediction(
            surface=height + correction, correction=correction,
            contact_logit=PHYSICS_CONTACT_LOGIT * (2.0 * contact - 1.0) + logit, contact_logit_correction=logit,
            log_error_scale=log_error.clamp(LOG_ERROR_MIN, LOG_ERROR_MAX),
            log_depth_factor=_average_over_contact(contact, log_factor),
        )  # fmt: skip


def _average_over_contact(contact: Tensor, log_factor: Tensor) -> Tensor:
    """Log of the depth factor (n,): the contact-weighted mean of its per-pixel values (n, rows, cols)."""
    weight = contact.clamp(min=0.0) + NON_CONTACT_WEIGHT
    mean = (log_factor * weight).sum(dim=(1, 2)) / weight.sum(dim=(1, 2))
    return (LOG_FACTOR_SCALE * mean).clamp(-LOG_FACTOR_LIMIT, LOG_FACTOR_LIMIT)


def integrate_slopes(slope_x: Tensor, slope_y: Tensor, coarse: Tensor, reach_px: float) -> Tensor:
    """The surface (n, rows, cols) nearest to slopes and, over lengths beyond `reach_px`, to the surface `coarse`."""
    edges_x = 0.5 * (slope_x[..., 1:] + slope_x[..., :-1])
    edges_y = 0.5 * (slope_y[..., 1:, :] + slope_y[..., :-1, :])
    pull = 1.0 / reach_px**2
    right = functional.pad(edges_x, (1, 0)) - functional.pad(edges_x, (0, 1))
    right = right + functional.pad(edges_y, (0, 0, 1, 0)) - functional.pad(edges_y, (0, 0, 0, 1)) + pull * coarse
    rows, cols = (int(n) for n in coarse.shape[-2:])
    down, across, eigenvalues = _compute_cosines(rows), _compute_cosines(cols), _compute_eigenvalues(rows, cols)
    wave = (down @ right @ across.T) / (eigenvalues + pull)
    return down.T @ wave @ across


@lru_cache(maxsize=16)
def _compute_cosines(n: int) -> Tensor:
    """The orthonormal cosine transform (n, n): row k is the wave k."""
    k, i = np.arange(n)[:, None], np.arange(n)[None, :]
    table = np.cos(math.pi * (i + 0.5) * k / n) * math.sqrt(2.0 / n)
    table[0] *= math.sqrt(0.5)
    return _make_constant(table)


@lru_cache(maxsize=16)
def _compute_eigenvalues(rows: int, cols: int) -> Tensor:
    """Eigenvalues (rows, cols) of D'D."""
    ky, kx = (2.0 * np.sin(np.arange(n) * (0.5 * math.pi / n)) for n in (rows, cols))
    return _make_constant(ky[:, None] ** 2 + kx[None, :] ** 2)


def _make_constant(values: Doubles) -> Tensor:
    with torch.inference_mode(False):  # the first caller may be in inference mode; gradients pass through it later
        return torch.from_numpy(values.astype(np.float32))
