"""Correlated noise: standard normal, correlated nearby, and with the right sample variance."""

import math

import pytest
import torch

from pipeline.stages.networks.residual_denoiser import correlate_noise
from pipeline.stages.networks.samplers import make_sigma_schedule, sample

LENGTH = 0.125


def white(n, rows=48, cols=64, seed=0):
    return torch.randn(n, 2, rows, cols, generator=torch.Generator().manual_seed(seed))


def test_it_is_standard_normal_and_correlated():
    made = correlate_noise(white(300), LENGTH)
    assert abs(float(made.mean())) < 0.03
    assert float(made.std()) == pytest.approx(1.0, abs=0.03)
    assert float(made.std(dim=(0, 1)).std()) < 0.05, "no place is noisier than another"
    far = round(LENGTH * 48)
    for apart, expected in ((1, math.exp(-1 / far)), (far, math.exp(-1.0)), (24, 0.0)):
        found = float((made[..., :24] * made[..., apart : apart + 24]).mean())
        assert found == pytest.approx(expected, abs=0.1), apart


@pytest.mark.parametrize("size", [(33, 20), (20, 33), (17, 17)])
def test_any_size_is_kept_and_channels_are_independent(size):
    made = correlate_noise(white(400, *size), LENGTH)
    assert made.shape == (400, 2, *size)
    assert abs(float((made[:, 0] * made[:, 1]).mean())) < 0.05


def test_zero_correlation_length_returns_the_input():
    noise = white(1)
    assert correlate_noise(noise, 0.0) is noise


@pytest.mark.parametrize("solver", ["dpmpp_2m", "corrected"])
@pytest.mark.parametrize("spread", [0.3, 1.0])
def test_samples_of_the_exact_denoiser_have_the_data_variance(solver, spread):
    middle = torch.linspace(-1, 1, 64)

    def denoise(noisy, sigma):
        if sigma >= 10.0:
            return middle.expand_as(noisy)
        return middle + (noisy - middle) * spread**2 / (spread**2 + sigma**2)

    made = sample(
        denoise,
        correlate_noise(white(200), LENGTH),
        make_sigma_schedule(30, sigma_max=10.0, sigma_min=0.05),
        solver=solver,
    ).clean
    assert float(made.std(0).mean()) == pytest.approx(spread, rel=0.12)
    assert float((made.mean(0) - middle).abs().mean()) < 0.15 * spread
