"""Spatially correlated noise for diffusion, as smooth as the fields it is added to.

White noise has little power at the long wavelengths where a membrane has nearly all of its power.
Whether an object is present would be decided at noise levels hundreds of times the field, where the
network sees nothing, and all samples would be equal. Noise with the spectrum of the fields hides
large and small structures at the same level. Diffusion theory holds for any noise covariance, so
the samplers are unchanged.
"""

import math

import torch
from torch import Tensor

from pipeline.core.derived import derive_once

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


@derive_once
def _amplitude(rows: int, cols: int, length: float) -> Tensor:
    """(rows, cols // 2 + 1) factor of each Fourier component, normalised to unit variance."""
    wave = torch.fft.fftfreq(rows)[:, None] ** 2 + torch.fft.fftfreq(cols)[None] ** 2
    power = (wave + (2.0 * math.pi * length * rows) ** -2) ** -_POWER
    return torch.sqrt(power / power.mean())[:, : cols // 2 + 1]
