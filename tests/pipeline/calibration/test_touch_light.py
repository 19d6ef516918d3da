from __future__ import annotations

import numpy as np
import pytest

from pipeline.calibration import near_led_prior, shading_field, shading_posterior, slope_model
from pipeline.calibration.shading_field import SurfaceSamples
from pipeline.sensors.spec import load_sensor

SHAPE, PIXEL_MM = (240, 320), 0.0634
DEPTHS = (0.5, 1.0, 2.0)
EXACT = 1e-4  # of q: single precision


def field_of(seed):
    optics = load_sensor("gelsight_mini").optics
    return near_led_prior.sample_instances(optics, PIXEL_MM, SHAPE, 1, np.random.default_rng(seed))[0].ravel()


def shown(coefficients, depth, rng_seed=0):
    """Pixels of a dent `depth` times as deep as the one that a unit shows."""
    rng = np.random.default_rng(rng_seed)
    u, v = rng.uniform(-0.2, 0.2, (2, 400))
    angle, steep = rng.uniform(0, 2 * np.pi, 400), 0.4 * np.sqrt(rng.random(400))
    slopes, deep = np.stack([steep * np.cos(angle), steep * np.sin(angle)], axis=1), rng.uniform(0.1, 0.5, 400)
    q = shading_field.predict_colours(
        coefficients, shading_field.compute_position_terms(u, v), shading_field.compute_shading_terms(slopes, deep)
    )
    parts = shading_field.compute_shading_terms(depth * slopes, depth * deep)
    return SurfaceSamples(
        u=u.astype(np.float32), v=v.astype(np.float32), shading_terms=parts, change=q.astype(np.float32)
    )


@pytest.fixture(scope="module")
def before():
    return near_led_prior.compute_prior(load_sensor("gelsight_mini"), PIXEL_MM, SHAPE)


def test_the_depth_under_which_a_usual_unit_shows_the_colours_is_the_likeliest(before):
    usual = before.mean
    best, told = shading_posterior.choose_likeliest_surface(before, [shown(usual, depth) for depth in DEPTHS])
    assert DEPTHS[best] == 1.0
    true = shown(usual, 1.0)
    seen = shading_field.predict_colours(told, shading_field.compute_position_terms(true.u, true.v), true.shading_terms)
    assert np.sqrt(np.mean((seen - true.change) ** 2)) < 0.02


def test_most_units_are_told_by_their_depth(before):
    best = [
        shading_posterior.choose_likeliest_surface(before, [shown(field_of(k), d, k) for d in DEPTHS])[0]
        for k in range(6)
    ]
    assert sum(DEPTHS[b] == 1.0 for b in best) >= 4


def test_the_field_of_a_picture_is_that_of_its_places():
    field = field_of(1)
    u, v = slope_model.compute_positions((12, 16))
    made = shading_posterior.expand_field(field, u, v)
    where = np.meshgrid(u, v)
    told = shading_field.compute_position_terms(where[0].ravel(), where[1].ravel())
    table = np.einsum(
        "np,kpi->nki", told, field.reshape(3, shading_field.N_POSITION_TERMS, shading_field.N_SHADING_TERMS)
    )
    assert made.shape == (12, 16, 3, 4)
    assert np.abs(made - table.reshape(made.shape)).max() < EXACT
