"""Shading fields of LEDs close to the gel, fitted to one touch."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.calibration import near_led_prior, shading_field, slope_model
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.illumination import field_light
from pipeline.stages.depth.illumination.field_light import DentSamples

SHAPE = (240, 320)
PIXEL_MM = 0.0634
WRONG_DEPTHS = (0.5, 0.7, 1.5, 2.0)
PRECISION = 1e-4  # of q: single precision


def draw_field(seed):
    optics = load_sensor("gelsight_mini").optics
    return near_led_prior.sample_instances(optics, PIXEL_MM, SHAPE, 1, np.random.default_rng(seed))[
        0
    ].ravel()


def render_samples(coefficients, depth, seed=0):
    """Colours of a dent, at cells of a dent `depth` times as deep."""
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(-0.2, 0.2, (2, 20)).astype(np.float32)
    angle = rng.uniform(0, 2 * np.pi, (20, 20))
    steep = 0.4 * np.sqrt(rng.random((20, 20)))
    dent = [steep * np.cos(angle), steep * np.sin(angle), rng.uniform(0.1, 0.5, (20, 20))]
    at, terms = describe_cells(u, v, *dent)
    q = shading_field.predict_colours(coefficients, at, terms).reshape(20, 20, 3)
    scaled = ((depth * a).astype(np.float32) for a in dent)
    return DentSamples(u, v, *scaled, q.astype(np.float32), np.ones((20, 20), np.bool_))


def describe_cells(u, v, gx, gy, indentation_mm):
    """Position terms and shading terms of all cells of a grid."""
    across, down = np.meshgrid(u, v)
    slopes = np.stack([gx.ravel(), gy.ravel()], axis=1).astype(np.float64)
    terms = shading_field.compute_shading_terms(slopes, indentation_mm.ravel())
    return shading_field.compute_position_terms(across.ravel(), down.ravel()), terms


@pytest.fixture(scope="module")
def prior():
    return near_led_prior.compute_prior(load_sensor("gelsight_mini"), PIXEL_MM, SHAPE)


def estimate_from(prior, coefficients, depth):
    """What is estimated from a dent `depth` times as deep as the colours are of."""
    return field_light.estimate_likeliest_depth(
        prior, lambda factor: render_samples(coefficients, depth * factor)
    )


@pytest.mark.parametrize("depth", WRONG_DEPTHS)
def test_a_wrong_depth_comes_nearer_to_the_true_one(prior, depth):
    for field in (prior.mean, *(draw_field(k) for k in range(6))):
        factor, sums = estimate_from(prior, field, depth)
        assert abs(np.log(depth * factor)) < abs(np.log(depth)) - 0.1
        coefficients, _ = field_light.compute_posterior(prior, [sums])
        dent = render_samples(field, depth * factor)
        rendered = shading_field.predict_colours(coefficients, *describe_cells(*dent[:5]))
        assert np.sqrt(np.mean((rendered - dent.change.reshape(-1, 3)) ** 2)) < 0.02


def test_the_depth_moves_with_the_colours_without_a_jump(prior):
    coefficients = draw_field(2)
    factors = [estimate_from(prior, coefficients, depth)[0] for depth in np.linspace(0.9, 1.1, 21)]
    assert np.abs(np.diff(np.log(factors))).max() < 0.02


def test_an_expanded_field_equals_its_polynomials():
    coefficients = draw_field(1)
    u, v = slope_model.compute_positions((12, 16))
    field = field_light.expand_field(coefficients, u, v)
    across, down = np.meshgrid(u, v)
    at = shading_field.compute_position_terms(across.ravel(), down.ravel())
    table = coefficients.reshape(3, shading_field.N_POSITION_TERMS, shading_field.N_SHADING_TERMS)
    expected = np.einsum("np,kpi->nki", at, table).reshape(field.shape)
    assert field.shape == (12, 16, 3, 4)
    assert np.abs(field - expected).max() < PRECISION
