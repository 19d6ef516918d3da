"""Data with a known exact denoiser: normal distributions around points, some of them selected by
a condition.
"""

from __future__ import annotations

import numpy as np

MODES = 24
SIZE = 32
PICKED = 3


def modes(scale: float = 1.0, seed: int = 0):
    """(modes, size) centres."""
    return np.random.default_rng(seed).normal(size=(MODES, SIZE)) * scale


def denoiser(centres, spread: float):
    """The expected clean points (n, size) behind noisy ones, for equally likely centres with a
    normal spread.
    """

    def denoise(noisy, sigma):
        variance = spread**2 + sigma**2
        log = -((noisy[:, None] - centres) ** 2).sum(-1) / (2 * variance)
        share = np.exp(log - log.max(axis=1, keepdims=True))
        near = share / share.sum(axis=1, keepdims=True) @ centres
        return (spread**2 * noisy + sigma**2 * near) / variance

    return denoise
