"""Noise as smooth as the fields that it hides.

White noise has hardly any power where a membrane has nearly all: a body that may or may not be there is settled while
the noise is hundreds of times as strong as the field, where a network sees nothing yet, and all samples come out alike.
Noise with the spectrum of the fields hides large and small parts at the same strength. What is known of diffusion holds
for any covariance of the noise: the samplers need not know of it.
"""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from torch import Tensor

_POWER = 1.5  # of an exponential covariance in the plane: fields with edges


def correlate_noise(white: Tensor, correlation_length: float) -> Tensor:
    """Of standard normal numbers (..., rows, cols): as many whose neighbours are alike, each standard normal still.

    Their correlation falls as exp(-distance / (length * rows)), around the picture's edges; 0 leaves them as they are.
    """
    if correlation_length <= 0.0:
        return white
    rows, cols = white.shape[-2:]
    amplitude = _amplitude(rows, cols, correlation_length).to(white.device)
    return torch.fft.irfft2(torch.fft.rfft2(white) * amplitude, s=(rows, cols))


@lru_cache(maxsize=8)
def _amplitude(rows: int, cols: int, length: float) -> Tensor:
    """(rows, cols // 2 + 1): what each wave is multiplied by, so that the variance stays 1."""
    wave = torch.fft.fftfreq(rows)[:, None] ** 2 + torch.fft.fftfreq(cols)[None] ** 2
    power = (wave + (2.0 * math.pi * length * rows) ** -2) ** -_POWER
    return torch.sqrt(power / power.mean())[:, : cols // 2 + 1]
