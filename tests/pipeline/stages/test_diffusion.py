"""Sampling a residual: what it costs, that it can be stopped, that it is the same again, and sane for every setting."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.base.progress import Cancelled
from pipeline.stages.touch.residual_diffusion import DiffusionParams, sample_residual
from tests.pipeline.networks.test_residual_denoiser import PREDICTIONS, small

SAMPLERS = ("ddim", "dpmpp_2m", "corrected")
CONDITION = np.random.default_rng(0).normal(size=(3, 12, 16)).astype(np.float32)


def taking_all(**how):
    """Parameters that hold nothing back, unless told to."""
    return DiffusionParams(**{"confidence_weighting": 0.0, **how})


class Counts(torch.nn.Module):
    """A denoiser of a known field that counts its passes and those without a condition."""

    unit_mm, sigma_max, sigma_min, field_limit, noise_correlation = 2.0, 8.0, 0.02, 8.0, 0.0

    def __init__(self, spread=0.5):
        super().__init__()
        self.passes, self.bare, self.log_spread = 0, 0, float(np.log(spread))

    def forward(self, noisy, sigma, condition):
        self.passes += 1
        self.bare += not condition.any()
        level = float(sigma[0])
        clean = (0.1**2 * noisy + level**2 * condition[:, :2].clamp(-1, 1)) / (0.1**2 + level**2)
        return torch.cat([clean, torch.full_like(clean[:, :1], self.log_spread)], 1)


@pytest.mark.parametrize("steps", [1, 2, 5, 23])
@pytest.mark.parametrize("guidance", [0.0, 1.0])
def test_without_guidance_a_step_costs_one_pass(steps, guidance):
    net = Counts()
    found = sample_residual(net, CONDITION, taking_all(steps=steps, guidance=guidance))
    assert found.passes == steps
    assert net.passes == steps + (guidance == 0.0), "its spread has to be asked for where no condition ever was"
    assert net.bare == (steps if guidance == 0.0 else 0)


def test_guidance_costs_two_passes_a_step():
    net = Counts()
    assert sample_residual(net, CONDITION, taking_all(steps=40, guidance=2.5)).passes == net.passes == 80


def test_one_step_is_the_middle_whatever_the_seed_and_many_are_a_sample_near_it():
    told = 2.0 * np.clip(CONDITION[0], -1, 1)
    first = [sample_residual(Counts(), CONDITION, taking_all(seed=seed)).final.residual_mm for seed in (0, 1)]
    assert np.abs(first[0] - first[1]).max() < 0.02
    assert np.abs(first[0] - told).max() < 0.02
    many = sample_residual(Counts(), CONDITION, taking_all(steps=30, seed=3)).final.residual_mm
    assert 0.1 < (many - told).std() < 0.3  # 0.1 of the network's unit around it


def test_the_same_seed_gives_the_same_bytes_and_another_one_does_not():
    params = taking_all(steps=6, seed=5)
    a, b, other = (sample_residual(small(), CONDITION, p).final for p in (params, params, replace(params, seed=6)))
    assert a.residual_mm.tobytes() == b.residual_mm.tobytes()
    assert a.contact_correction.tobytes() == b.contact_correction.tobytes()
    assert a.residual_mm.tobytes() != other.residual_mm.tobytes()


@pytest.mark.parametrize("stop_after", range(1, 7))
def test_it_can_be_stopped_between_any_two_passes(stop_after):
    net = Counts()

    class Stops:
        def step(self, fraction, text):
            if net.passes >= stop_after:
                raise Cancelled

    with pytest.raises(Cancelled):
        sample_residual(net, CONDITION, taking_all(steps=40, guidance=2.5), Stops())
    assert net.passes == stop_after


@pytest.mark.parametrize("steps", [1, 7, 50, 51, 333])
def test_kept_states_lead_to_the_sample_and_are_not_too_many(steps):
    found = sample_residual(Counts(), CONDITION, taking_all(steps=steps, keep_states=True))
    assert 1 <= len(found.states) <= min(50, steps)
    assert found.states[-1].residual_mm.tobytes() == found.final.residual_mm.tobytes()
    assert [s.sigma for s in found.states] == sorted((s.sigma for s in found.states), reverse=True)
    assert not sample_residual(Counts(), CONDITION, taking_all(steps=steps)).states


def test_few_steps_for_much_guidance_are_said():
    assert "without it" in sample_residual(Counts(), CONDITION, taking_all(steps=2, guidance=7.0)).notes[0]


@pytest.mark.parametrize("prediction", PREDICTIONS)
def test_every_number_of_steps_guidance_and_sampler_stays_finite_and_within_reach(prediction):
    """An untrained network is the hardest case: nothing that it says belongs together."""
    net, tiny = small(prediction, levels=1), CONDITION[:, :4, :4]
    table = itertools.product((1, 2, 3, 4, 5, 8, 11, 12, 19, 20), (0.0, 1.0, 1.5, 2.54, 7.0, 15.0), SAMPLERS)
    long = [(50, 7.0, "corrected"), (999, 2.54, "dpmpp_2m"), (1000, 15.0, "corrected")]
    for steps, guidance, sampler in (*table, *long):
        found = sample_residual(net, tiny, taking_all(steps=steps, guidance=guidance, sampler=sampler))
        told = prediction, steps, guidance, sampler
        assert np.isfinite(found.final.residual_mm).all(), told
        assert np.abs(found.final.residual_mm).max() <= net.field_limit * net.unit_mm + 1e-5, told
        assert np.isfinite(found.final.contact_correction).all(), told
        assert np.isfinite(found.expected_error_mm).all(), told
