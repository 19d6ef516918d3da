"""The shading field of an instance, from a few indentations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration import near_led_prior, shading_field, slope_model
from pipeline.calibration.shading_field import SurfaceSamples
from pipeline.calibration.slope_model import SlopeSamples
from pipeline.core.errors import SettingProblem
from pipeline.sensors.spec import load_sensor

SHAPE = (240, 320)
PIXEL_MM = 0.0634
COLOUR_TOLERANCE = 0.05  # of q: the noise that the field assumes
SLOPE_TOLERANCE = 0.06  # rms mm/mm: the field's noise over its response to slopes


@pytest.fixture(scope="module")
def prior():
    return near_led_prior.compute_prior(load_sensor("gelsight_mini"), PIXEL_MM, SHAPE)


@pytest.fixture(scope="module")
def instance():
    optics = load_sensor("gelsight_mini").optics
    return near_led_prior.sample_instances(optics, PIXEL_MM, SHAPE, 1, np.random.default_rng(5))[
        0
    ].ravel()


def render_colours(coefficients, samples):
    at = shading_field.compute_position_terms(samples.u, samples.v)
    return shading_field.predict_colours(coefficients, at, samples.shading_terms)


def indent(instance, rng, x, y, count=300):
    """Samples of an indentation at (x, y) in halves of the image, and their slopes."""
    u, v = (c + rng.uniform(-0.17, 0.17, count) for c in (x, y))
    angle = rng.uniform(0, 2 * np.pi, count)
    steep = 0.6 * np.sqrt(rng.random(count))
    slopes = np.stack([steep * np.cos(angle), steep * np.sin(angle)], axis=1)
    terms = shading_field.compute_shading_terms(slopes, rng.uniform(0.3, 0.8, count))
    colours = shading_field.predict_colours(
        instance, shading_field.compute_position_terms(u, v), terms
    )
    u, v, colours = (a.astype(np.float32) for a in (u, v, colours))
    return SurfaceSamples(u=u, v=v, shading_terms=terms, change=colours), slopes


def test_indentations_all_over_the_image_determine_the_field(prior, instance):
    rng = np.random.default_rng(0)
    samples = [
        indent(instance, rng, x, y)[0]
        for x in (-0.8, -0.4, 0.0, 0.4, 0.8)
        for y in (-0.6, -0.2, 0.2, 0.6)
    ]
    field = shading_field.update_field(prior, samples)
    new, _ = indent(instance, rng, 0.2, 0.1)
    assert np.sqrt(np.mean((render_colours(field.mean, new) - new.change) ** 2)) < COLOUR_TOLERANCE


def test_an_indentation_narrows_the_field_where_it_is_and_not_across_the_image(prior, instance):
    field = shading_field.update_field(
        prior, [indent(instance, np.random.default_rng(1), -0.7, -0.4)[0]]
    )

    def spread(fields, x, y):
        at = shading_field.compute_position_terms(np.float32([x]), np.float32([y]))
        terms = np.array([[0.3, 0.0, -0.05, 0.0]])
        drawn = shading_field.sample_fields(fields, 60, np.random.default_rng(2))
        return np.std(
            [shading_field.predict_colours(one, at, terms)[0] for one in drawn], axis=0
        ).mean()

    assert spread(field, -0.7, -0.4) < 0.5 * spread(prior, -0.7, -0.4)
    assert spread(field, 0.8, 0.6) > 0.5 * spread(prior, 0.8, 0.6)


def test_outliers_in_a_tenth_of_an_indentation_change_little(prior, instance):
    clean, _ = indent(instance, np.random.default_rng(3), 0.0, 0.0)
    dirty = clean.change.copy()
    dirty[::10] += 2.0
    fields = [
        shading_field.update_field(prior, [replace(clean, change=c)]).mean
        for c in (clean.change, dirty)
    ]
    difference = render_colours(fields[1], clean) - render_colours(fields[0], clean)
    assert np.sqrt(np.mean(difference**2)) < 0.1  # a plain mean differs by 0.2


def test_the_slope_model_of_a_known_field_recovers_slopes_at_any_depth(instance):
    model = shading_field.fit_slope_model(instance[None], SHAPE, 8000, np.random.default_rng(0))
    new, slopes = indent(instance, np.random.default_rng(4), 0.1, -0.2)
    samples = SlopeSamples(change=new.change, u=new.u, v=new.v, slopes=slopes.astype(np.float32))
    assert np.sqrt(np.mean((slope_model.predict(model, samples) - slopes) ** 2)) < SLOPE_TOLERANCE


def test_a_sensor_without_optics_has_no_prior():
    with pytest.raises(SettingProblem, match="soft_bubble"):
        near_led_prior.compute_prior(load_sensor("soft_bubble"), PIXEL_MM, SHAPE)
