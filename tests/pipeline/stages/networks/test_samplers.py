"""Samplers on data with a known exact denoiser: correct in the limit, bounded elsewhere."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.errors import SettingProblem
from pipeline.core.progress import Cancelled
from pipeline.stages.networks.samplers import (
    MAX_WEIGHT,
    GuidedDenoiser,
    make_sigma_schedule,
    make_timestep_schedule,
    plan_guidance,
    sample,
)
from tests.pipeline.stages.networks.mixtures import PICKED, denoiser, modes

SOLVERS = ("ddim", "dpmpp_2m", "corrected")
MOST = 80.0
LEAST = 0.002


def _noise(n=60, seed=1):
    return np.random.default_rng(seed).normal(size=(n, modes().shape[1]))


def _error(solver, steps, denoise):
    """Relative to the same path in two thousand fine steps."""
    noise = _noise()
    levels = make_sigma_schedule(1000, sigma_max=MOST, sigma_min=LEAST)
    truth = sample(denoise, noise, levels, solver="corrected").clean
    found = sample(
        denoise, noise, make_sigma_schedule(steps, sigma_max=MOST, sigma_min=LEAST), solver=solver
    ).clean
    return math.sqrt(((found - truth) ** 2).mean() / (truth**2).mean())


@pytest.mark.parametrize(
    ("solver", "gains"), [("ddim", 1.6), ("dpmpp_2m", 3.0), ("corrected", 5.0)]
)
def test_doubling_the_steps_reduces_the_error_by_the_solver_order(solver, gains):
    denoise = denoiser(modes(), 0.3)
    assert _error(solver, 100, denoise) * gains < _error(solver, 50, denoise)


def test_one_step_gives_the_posterior_mean():
    """It is the same for every noise."""
    denoise = denoiser(modes(), 0.3)
    levels = make_sigma_schedule(1, sigma_max=1e4, sigma_min=LEAST)
    for solver in SOLVERS:
        answer = sample(denoise, _noise(), levels, solver=solver)
        assert answer.passes == 1
        np.testing.assert_allclose(
            answer.clean, np.broadcast_to(modes().mean(axis=0), answer.clean.shape), atol=0.02
        )


@pytest.mark.parametrize("solver", SOLVERS)
def test_samples_have_the_distribution_of_the_data(solver):
    def denoise(noisy, sigma):  # of a normal distribution around 0.4
        return (0.05**2 * noisy + sigma**2 * 0.4) / (0.05**2 + sigma**2)

    noise = np.random.default_rng(2).normal(size=(20000, 1))
    clean = sample(
        denoise, noise, make_sigma_schedule(100, sigma_max=MOST, sigma_min=LEAST), solver=solver
    ).clean
    assert clean.mean() == pytest.approx(0.4, abs=0.002)
    assert clean.std() == pytest.approx(0.05, rel=0.06)


def test_samples_stay_in_the_data_range_for_all_settings():
    conditional = denoiser(modes()[:PICKED], 0.05)
    unconditional = denoiser(modes(), 0.05)
    reach = float(abs(modes()).max()) + 0.3
    noise = _noise(4)
    cases = itertools.product(
        (*range(1, 21), 50, 200, 999, 1000), (0.0, 1.0, 1.5, 2.54, 7.0, 15.0), SOLVERS
    )
    for steps, weight, solver in cases:
        if steps > 200 and solver != "corrected" and weight not in (2.54, 15.0):
            continue  # as at 200, only longer
        how = plan_guidance(weight, steps, reach)
        guided = GuidedDenoiser(conditional, unconditional, how, reach)
        levels = make_sigma_schedule(steps, sigma_max=MOST, sigma_min=LEAST)
        clean = sample(guided, noise, levels, solver=solver, max_degree=how.max_degree).clean
        assert np.isfinite(clean).all(), (steps, weight, solver)
        assert abs(clean).max() <= reach + 1e-9, (steps, weight, solver)


@given(st.integers(1, 60), st.sampled_from((0.0, 1.0)))
def test_no_guidance_costs_one_pass_per_step(steps, weight):
    counted = GuidedDenoiser(
        lambda x, _: 0.5 * x, lambda x, _: 0.4 * x, plan_guidance(weight, steps, 10.0), 10.0
    )
    assert (
        sample(
            counted, np.ones((1, 2)), make_sigma_schedule(steps, sigma_max=MOST, sigma_min=LEAST)
        ).passes
        == steps
    )
    assert counted.passes == steps


def test_guidance_costs_two_passes_in_its_interval():
    how = plan_guidance(2.54, 50, 1e9)
    levels = make_sigma_schedule(50, sigma_max=MOST, sigma_min=LEAST)
    counted = GuidedDenoiser(lambda x, _: 0.5 * x, lambda x, _: 0.4 * x, how, 1e9)
    together = GuidedDenoiser(counted, counted, how, 1e9, lambda x, _: (0.5 * x, 0.4 * x))
    found = [sample(guided, np.ones((1, 2)), levels).clean for guided in (counted, together)]
    assert counted.passes == together.passes == 100
    assert np.array_equal(*found)


def test_too_few_steps_for_guidance_are_noted():
    how = plan_guidance(2.54, 3, 1.0)
    assert how.weight == 1.0
    assert "without guidance" in how.note


@given(st.integers(1, 1000))
def test_noise_levels_fall_strictly_to_zero(steps):
    levels = make_sigma_schedule(steps, sigma_max=MOST, sigma_min=LEAST)
    assert len(levels) == steps + 1
    assert (np.diff(levels) < 0).all()
    assert levels[-1] == 0.0


@given(st.integers(1, 1000), st.sampled_from((25, 50, 100, 999, 1000)))
def test_timesteps_are_unique_and_start_at_the_last(steps, count):
    cumulative = np.cumprod(1 - np.linspace(math.sqrt(0.0015), math.sqrt(0.0155), count) ** 2)
    levels, times = make_timestep_schedule(steps, cumulative)
    assert times[0] == count - 1
    assert len(set(times)) == len(times) == len(levels) - 1 == min(steps, count)
    assert (np.diff(times) < 0).all()
    assert (np.diff(levels) < 0).all()


@given(st.integers(2, 1000))
def test_leading_times_are_those_of_the_published_sampler(steps):
    cumulative = np.cumprod(1 - np.linspace(math.sqrt(0.0015), math.sqrt(0.0155), 1000) ** 2)
    _, times = make_timestep_schedule(steps, cumulative, is_leading=True)
    published = [time + 1 for time in range(0, 1000, 1000 // steps)]  # make_ddim_timesteps
    assert list(times) == [time for time in reversed(published) if time < 1000]
    assert len(times) >= steps - 1
    if steps == 10:
        assert times[:2] == (901, 801)


def test_a_single_step_starts_at_pure_noise():
    cumulative = np.linspace(0.99, 0.01, 1000)
    alike = [make_timestep_schedule(1, cumulative, is_leading=x)[1] for x in (True, False)]
    assert alike == [(999,), (999,)]


def test_a_signal_share_of_zero_is_refused():
    with pytest.raises(SettingProblem, match="between 0 and 1"):
        make_timestep_schedule(5, np.linspace(0.9, 0.0, 10))


@pytest.mark.parametrize("steps", [0, -3, 1001])
def test_a_number_of_steps_out_of_range_is_refused(steps):
    with pytest.raises(SettingProblem, match="between 1 and 1000"):
        make_sigma_schedule(steps, sigma_max=MOST, sigma_min=LEAST)


@pytest.mark.parametrize("weight", [-0.1, MAX_WEIGHT + 1, math.nan, math.inf])
def test_a_guidance_out_of_range_is_refused(weight):
    with pytest.raises(SettingProblem, match="guidance scale"):
        plan_guidance(weight, 50, 1.0)


def test_sampling_can_be_cancelled_between_passes():
    class Stops:
        def step(self, fraction, text):
            if fraction >= 0.5:
                raise Cancelled

    passes = []

    def denoise(noisy, sigma):
        passes.append(sigma)
        return noisy

    with pytest.raises(Cancelled):
        sample(
            denoise,
            np.ones(3),
            make_sigma_schedule(10, sigma_max=MOST, sigma_min=LEAST),
            progress=Stops(),
        )
    assert len(passes) == 5


def test_kept_steps_end_with_the_sample():
    denoise = denoiser(modes(), 0.3)
    answer = sample(
        denoise,
        _noise(2),
        make_sigma_schedule(12, sigma_max=MOST, sigma_min=LEAST),
        keep_steps=True,
    )
    assert len(answer.steps) == 12
    np.testing.assert_array_equal(answer.steps[-1].clean, answer.clean)
