"""A compact denoiser of residuals: what is added to a prior estimate, from a noisy residual and a
condition.

A U-Net like `compact_unet` with a noise embedding: every block scales and shifts its normalised
features by functions of log sigma. Values are in units of `unit_mm`; noisy = clean + sigma * noise,
as in `samplers`. The network predicts the clean field. At `sigma_max` the noisy field is replaced
by 0, so that the first step and one-step inference use the condition alone.

The last channel is the expected error of the clean field. `error_factor_in_view` and
`error_factor_outside` calibrate it inside and outside the source's contact, `error_exponent` is its
power. `noise_correlation` is the correlation length of the noise (`correlate_noise`).
`trained_on_recordings`: by recorded pairs, which know how the sensors lie to each other better than
their descriptions, so that physics is no prior.

Spatially correlated noise for diffusion, as smooth as the fields it is added to.

White noise has little power at the long wavelengths where a membrane has nearly all of its power.
Whether an object is present would be decided at noise levels hundreds of times the field, where the
network sees nothing, and all samples would be equal. Noise with the spectrum of the fields hides
large and small structures at the same level. Diffusion theory holds for any noise covariance, so
the samplers are unchanged.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from pipeline.stages.networks.compact_unet import CompactUnet, make_fold_kernel, run_unet
from pipeline.stages.networks.onnx_predictor import FIELD_LIMIT
from pipeline.stages.networks.onnx_predictor import ResidualConstants as Constants

FIELD_CHANNELS = 2  # denoised channels: indentation and contact
_N_WAVES = 16  # frequencies of the noise embedding
_EMBEDDING_WIDTH = 64  # width of the noise embedding


class ResidualDenoiser(nn.Module):
    """Clean field and log of its expected error (n, FIELD_CHANNELS + 1, rows, cols), from a
    noisy field.
    """

    def __init__(
        self,
        *,
        inputs: int,
        unit_mm: float,
        base_channels: int = 32,
        levels: int = 4,
        max_channels: int = 112,
        fold: int = 2,
        sigma_max: float = Constants.sigma_max,
        sigma_min: float = Constants.sigma_min,
        noise_correlation: float = Constants.noise_correlation,
        error_factor_in_view: float = Constants.error_factor_in_view,
        error_factor_outside: float = Constants.error_factor_outside,
        error_exponent: float = Constants.error_exponent,
        trained_on_recordings: float = Constants.trained_on_recordings,
    ) -> None:
        super().__init__()
        self.unit_mm = unit_mm
        self.sigma_max = sigma_max
        self.sigma_min = sigma_min
        self.inputs = inputs
        self.fold = fold
        self.noise_correlation = noise_correlation
        self.error_factors = (error_factor_in_view, error_factor_outside)
        self.error_exponent = error_exponent
        self.trained_on_recordings = trained_on_recordings
        widths = [min(base_channels * 2**level, max_channels) for level in range(levels)]
        self.noise_embedding = nn.Sequential(
            nn.Linear(2 * _N_WAVES, _EMBEDDING_WIDTH),
            nn.SiLU(),
            nn.Linear(_EMBEDDING_WIDTH, _EMBEDDING_WIDTH),
            nn.SiLU(),
        )
        self.start = _Block((inputs + FIELD_CHANNELS) * fold * fold, widths[0])
        self.down = nn.ModuleList(_Pair(narrow, wide) for narrow, wide in pairwise(widths))
        self.thin = nn.ModuleList(nn.Conv2d(wide, narrow, 1) for narrow, wide in pairwise(widths))
        self.merge = nn.ModuleList(_Block(width, width) for width in widths[:-1])
        self.finish = nn.Conv2d(widths[0], (FIELD_CHANNELS + 1) * fold * fold, 3, padding=1)
        nn.init.zeros_(self.finish.weight)  # an untrained network adds nothing
        nn.init.zeros_(cast("Tensor", self.finish.bias))

    def forward(self, noisy: Tensor, sigma: Tensor, condition: Tensor) -> Tensor:
        """Denoise a batch: noisy (n, FIELD_CHANNELS, rows, cols), sigma (n,), condition (n,
        inputs, rows, cols).
        """
        level = sigma.reshape(-1, 1, 1, 1)
        scaled = torch.where(
            level < self.sigma_max, noisy / torch.sqrt(1.0 + level**2), torch.zeros_like(noisy)
        )
        output = run_unet(
            self,
            torch.cat([scaled, condition], 1),
            lambda padded: functional.pixel_unshuffle(padded, self.fold),
            self.noise_embedding(_embed_sigma(sigma)),
        ).float()
        clean = output[:, :FIELD_CHANNELS].clamp(-FIELD_LIMIT, FIELD_LIMIT)
        return torch.cat([clean, output[:, FIELD_CHANNELS:]], 1)

    @torch.no_grad()
    def make_first_pass(self) -> nn.Module:
        """The network at `sigma_max` as a function of the condition alone, for export
        (`onnx_predictor`).
        """
        return _FirstPass(self).eval()


class _Block(nn.Module):
    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.filter = nn.Conv2d(inputs, outputs, 3, padding=1, bias=False)
        self.norm = nn.BatchNorm2d(outputs)
        self.modulation = nn.Linear(_EMBEDDING_WIDTH, 2 * outputs)
        nn.init.zeros_(self.modulation.weight)
        nn.init.zeros_(self.modulation.bias)

    def forward(self, field: Tensor, embedding: Tensor) -> Tensor:
        scale, shift = self.modulation(embedding).chunk(2, 1)
        if not self.training and len(field) == 1:
            weight, bias = self._fold(1.0 + scale[0], shift[0])
            return functional.relu(functional.conv2d(field, weight, bias, padding=1))
        normed = self.norm(self.filter(field))
        return functional.relu(
            torch.addcmul(shift[..., None, None], normed, 1.0 + scale[..., None, None])
        )

    def make_convolution(self, embedding: Tensor, first_channel: int = 0) -> nn.Sequential:
        """The block at one noise level, as a convolution of its inputs from `first_channel` on."""
        scale, shift = self.modulation(embedding).chunk(2, 1)
        weight, bias = self._fold(1.0 + scale[0], shift[0])
        layer = nn.Conv2d(weight.shape[1] - first_channel, len(weight), 3, padding=1)
        layer.weight.copy_(weight[:, first_channel:])
        layer.bias = nn.Parameter(bias)
        return nn.Sequential(layer, nn.ReLU())

    def _fold(self, scale: Tensor, shift: Tensor) -> tuple[Tensor, Tensor]:
        """Weight and bias with normalisation and modulation folded into the convolution."""
        norm = self.norm
        assert norm.running_var is not None
        assert norm.running_mean is not None
        gain = norm.weight * torch.rsqrt(norm.running_var + norm.eps)
        weight = self.filter.weight * (scale * gain)[:, None, None, None]
        return weight, shift + scale * (norm.bias - norm.running_mean * gain)


class _Pair(nn.Module):
    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.first = _Block(inputs, outputs)
        self.second = _Block(outputs, outputs)

    def forward(self, field: Tensor, embedding: Tensor) -> Tensor:
        return self.second(self.first(field, embedding), embedding)


def _embed_sigma(sigma: Tensor) -> Tensor:
    """(n, 2 _N_WAVES) sines and cosines of log sigma."""
    phase = torch.log(sigma)[:, None] * (0.25 * 1.35 ** torch.arange(_N_WAVES, device=sigma.device))
    return torch.cat([phase.sin(), phase.cos()], 1)


class _FirstPass(CompactUnet):
    """A `ResidualDenoiser` at its largest noise, whose noisy field is 0: (1, inputs, rows, cols)
    to its output.
    """

    def __init__(self, net: ResidualDenoiser) -> None:
        nn.Module.__init__(self)
        embedding = net.noise_embedding(_embed_sigma(torch.tensor([net.sigma_max])))
        self.fold = net.fold
        self.inputs = net.inputs
        self.register_buffer(
            "fold_kernel", make_fold_kernel(net.inputs, net.fold), persistent=False
        )
        self.start = net.start.make_convolution(embedding, FIELD_CHANNELS * net.fold**2)
        pairs = cast("list[_Pair]", list(net.down))
        self.down = nn.ModuleList(
            nn.Sequential(
                pair.first.make_convolution(embedding), pair.second.make_convolution(embedding)
            )
            for pair in pairs
        )
        self.thin = net.thin
        self.merge = nn.ModuleList(
            block.make_convolution(embedding) for block in cast("list[_Block]", list(net.merge))
        )
        self.finish = net.finish


_POWER = 1.5  # spectrum of an exponential covariance in the plane, as of fields with edges


def correlate_noise(white: Tensor, correlation_length: float) -> Tensor:
    """Turn standard normal numbers (..., rows, cols) into correlated ones with unit variance.

    The correlation falls as exp(-distance / (correlation_length * rows)), periodic at the borders;
    0 returns the input.
    """
    if correlation_length <= 0.0:
        return white
    rows, cols = white.shape[-2:]
    amplitude = _amplitude(rows, cols, correlation_length).to(white.device)
    return torch.fft.irfft2(torch.fft.rfft2(white) * amplitude, s=(rows, cols))


def _amplitude(rows: int, cols: int, length: float) -> Tensor:
    """(rows, cols // 2 + 1) factor of each Fourier component, normalised to unit variance."""
    wave = torch.fft.fftfreq(rows)[:, None] ** 2 + torch.fft.fftfreq(cols)[None] ** 2
    power = (wave + (2.0 * math.pi * length * rows) ** -2) ** -_POWER
    return torch.sqrt(power / power.mean())[:, : cols // 2 + 1]
