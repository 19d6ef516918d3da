"""Sampling a residual: cost, cancelling, determinism, and bounded results for all settings."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.core.progress import Cancelled
from pipeline.stages.touch.residual_diffusion import FIELD_LIMIT, DiffusionParams, sample_residual
from tests.pipeline.stages.networks.test_residual_denoiser import small

SAMPLERS = ("ddim", "dpmpp_2m", "corrected")
CONDITION = np.random.default_rng(0).normal(size=(3, 12, 16)).astype(np.float32)


class CountingDenoiser(torch.nn.Module):
    """A denoiser of a known field that counts its passes and those without a condition."""

    unit_mm = 2.0
    sigma_max = 8.0
    sigma_min = 0.02
    noise_correlation = 0.0

    def __init__(self, spread=0.5):
        super().__init__()
        self.passes = 0
        self.bare = 0
        self.log_spread = float(np.log(spread))

    def forward(self, noisy, sigma, condition):
        self.passes += 1
        self.bare += not condition.any()
        level = float(sigma[0])
        clean = (0.1**2 * noisy + level**2 * condition[:, :2].clamp(-1, 1)) / (0.1**2 + level**2)
        return torch.cat([clean, torch.full_like(clean[:, :1], self.log_spread)], 1)


@pytest.mark.parametrize("steps", [1, 2, 5, 23])
@pytest.mark.parametrize("guidance", [0.0, 1.0])
def test_no_guidance_costs_one_pass_per_step(steps, guidance):
    net = CountingDenoiser()
    found = sample_residual(net, CONDITION, DiffusionParams(steps=steps, guidance=guidance))
    assert found.passes == steps
    assert net.passes == steps + (guidance == 0.0), "one more pass for the expected error"
    assert net.bare == (steps if guidance == 0.0 else 0)


def test_guidance_costs_two_passes_per_step():
    net = CountingDenoiser()
    assert (
        sample_residual(net, CONDITION, DiffusionParams(steps=40, guidance=2.5)).passes
        == net.passes
        == 80
    )


def test_one_step_is_the_posterior_mean_and_many_steps_a_sample():
    expected = 2.0 * np.clip(CONDITION[0], -1, 1)
    first = [
        sample_residual(CountingDenoiser(), CONDITION, DiffusionParams(seed=seed)).final.residual_mm
        for seed in (0, 1)
    ]
    assert np.abs(first[0] - first[1]).max() < 0.02
    assert np.abs(first[0] - expected).max() < 0.02
    many = sample_residual(
        CountingDenoiser(), CONDITION, DiffusionParams(steps=30, seed=3)
    ).final.residual_mm
    assert 0.1 < (many - expected).std() < 0.3  # 0.1 of the network's unit around it


def test_equal_seeds_give_equal_bytes():
    params = DiffusionParams(steps=6, seed=5)
    a, b, other = (
        sample_residual(small(), CONDITION, p).final
        for p in (params, params, replace(params, seed=6))
    )
    assert a.residual_mm.tobytes() == b.residual_mm.tobytes()
    assert a.contact_correction.tobytes() == b.contact_correction.tobytes()
    assert a.residual_mm.tobytes() != other.residual_mm.tobytes()


@pytest.mark.parametrize("stop_after", range(1, 7))
def test_sampling_can_be_cancelled_between_any_two_passes(stop_after):
    net = CountingDenoiser()

    class Stops:
        def step(self, fraction, text):
            if net.passes >= stop_after:
                raise Cancelled

    with pytest.raises(Cancelled):
        sample_residual(net, CONDITION, DiffusionParams(steps=40, guidance=2.5), Stops())
    assert net.passes == stop_after


@pytest.mark.parametrize("steps", [1, 7, 50, 51, 333])
def test_kept_states_are_limited_and_end_with_the_sample(steps):
    found = sample_residual(
        CountingDenoiser(), CONDITION, DiffusionParams(steps=steps, keep_states=True)
    )
    assert 1 <= len(found.states) <= min(50, steps)
    assert found.states[-1].residual_mm.tobytes() == found.final.residual_mm.tobytes()
    assert [s.sigma for s in found.states] == sorted((s.sigma for s in found.states), reverse=True)
    assert not sample_residual(CountingDenoiser(), CONDITION, DiffusionParams(steps=steps)).states


def test_too_few_steps_for_guidance_are_noted():
    assert (
        "without guidance"
        in sample_residual(
            CountingDenoiser(), CONDITION, DiffusionParams(steps=2, guidance=7.0)
        ).notes[0]
    )


def test_all_settings_give_finite_bounded_results():
    """An untrained network is the hardest case: its outputs are inconsistent."""
    net = small(levels=1)
    tiny = CONDITION[:, :4, :4]
    table = itertools.product(
        (1, 2, 3, 4, 5, 8, 11, 12, 19, 20), (0.0, 1.0, 1.5, 2.54, 7.0, 15.0), SAMPLERS
    )
    long = [(50, 7.0, "corrected"), (999, 2.54, "dpmpp_2m"), (1000, 15.0, "corrected")]
    for steps, guidance, sampler in (*table, *long):
        found = sample_residual(
            net, tiny, DiffusionParams(steps=steps, guidance=guidance, sampler=sampler)
        )
        expected = steps, guidance, sampler
        assert np.isfinite(found.final.residual_mm).all(), expected
        assert np.abs(found.final.residual_mm).max() <= FIELD_LIMIT * net.unit_mm + 1e-5, expected
        assert np.isfinite(found.final.contact_correction).all(), expected
        assert np.isfinite(found.expected_error_mm).all(), expected
