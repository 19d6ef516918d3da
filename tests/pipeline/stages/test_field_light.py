"""Shading fields of LEDs close to the gel, fitted to one touch."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.calibration import near_led_prior, shading_field, slope_model
from pipeline.calibration.shading_field import SurfaceSamples
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.illumination import field_light

SHAPE, PIXEL_MM = (240, 320), 0.0634
DEPTHS = (0.5, 1.0, 2.0)
PRECISION = 1e-4  # of q: single precision


def draw_field(seed):
    optics = load_sensor("gelsight_mini").optics
    return near_led_prior.sample_instances(optics, PIXEL_MM, SHAPE, 1, np.random.default_rng(seed))[0].ravel()


def render_samples(coefficients, depth, seed=0):
    """Colours of a dent, at pixels of a dent `depth` times as deep."""
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(-0.2, 0.2, (2, 400))
    angle, steep = rng.uniform(0, 2 * np.pi, 400), 0.4 * np.sqrt(rng.random(400))
    slopes, deep = np.stack([steep * np.cos(angle), steep * np.sin(angle)], axis=1), rng.uniform(0.1, 0.5, 400)
    at, terms = shading_field.compute_position_terms(u, v), shading_field.compute_shading_terms(slopes, deep)
    q = shading_field.predict_colours(coefficients, at, terms)
    terms = shading_field.compute_shading_terms(depth * slopes, depth * deep)
    return SurfaceSamples(
        u=u.astype(np.float32), v=v.astype(np.float32), shading_terms=terms, change=q.astype(np.float32)
    )


@pytest.fixture(scope="module")
def prior():
    return near_led_prior.compute_prior(load_sensor("gelsight_mini"), PIXEL_MM, SHAPE)


def test_the_true_depth_is_the_likeliest_in_usual_light(prior):
    samples = [render_samples(prior.mean, depth) for depth in DEPTHS]
    best, coefficients = field_light.choose_likeliest_surface(prior, samples)
    assert DEPTHS[best] == 1.0
    true = render_samples(prior.mean, 1.0)
    at = shading_field.compute_position_terms(true.u, true.v)
    rendered = shading_field.predict_colours(coefficients, at, true.shading_terms)
    assert np.sqrt(np.mean((rendered - true.change) ** 2)) < 0.02


def test_the_true_depth_is_the_likeliest_for_most_instances(prior):
    best = [
        field_light.choose_likeliest_surface(prior, [render_samples(draw_field(k), d, k) for d in DEPTHS])[0]
        for k in range(6)
    ]
    assert sum(DEPTHS[b] == 1.0 for b in best) >= 4


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
