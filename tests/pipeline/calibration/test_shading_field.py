from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.base.errors import CalibrationError
from pipeline.calibration import near_led_prior, shading_field, slope_model
from pipeline.calibration.shading_field import SurfaceSamples
from pipeline.calibration.slope_model import SlopeSamples
from pipeline.sensors.spec import load_sensor

SHAPE, PIXEL_MM = (240, 320), 0.0634
COLOUR_TOLERANCE = 0.05  # of q, what the field is told not to explain of a press
SLOPE_TOLERANCE = 0.06  # rms mm/mm: the field's noise over its pull on slopes


@pytest.fixture(scope="module")
def before():
    return near_led_prior.compute_prior(load_sensor("gelsight_mini"), PIXEL_MM, SHAPE)


@pytest.fixture(scope="module")
def unit():
    optics = load_sensor("gelsight_mini").optics
    return near_led_prior.sample_instances(optics, PIXEL_MM, SHAPE, 1, np.random.default_rng(5))[0].ravel()


def surface(unit, rng, x, y, count=300):
    """Pixels of a press at (x, y) in halves of the picture, coloured by `unit`."""
    u, v = (c + rng.uniform(-0.17, 0.17, count) for c in (x, y))
    angle, steep = rng.uniform(0, 2 * np.pi, count), 0.6 * np.sqrt(rng.random(count))
    slopes = np.stack([steep * np.cos(angle), steep * np.sin(angle)], axis=1)
    parts = shading_field.compute_shading_terms(slopes, rng.uniform(0.3, 0.8, count))
    seen = shading_field.predict_colours(unit, shading_field.compute_position_terms(u, v), parts)
    return SurfaceSamples(
        u=u.astype(np.float32), v=v.astype(np.float32), shading_terms=parts, change=seen.astype(np.float32)
    ), slopes


def test_presses_all_over_the_picture_tell_the_unit(before, unit):
    rng = np.random.default_rng(0)
    seen = [surface(unit, rng, x, y)[0] for x in (-0.8, -0.4, 0.0, 0.4, 0.8) for y in (-0.6, -0.2, 0.2, 0.6)]
    after = shading_field.update_field(before, seen)
    new, _ = surface(unit, rng, 0.2, 0.1)
    told = shading_field.predict_colours(
        after.mean, shading_field.compute_position_terms(new.u, new.v), new.shading_terms
    )
    assert np.sqrt(np.mean((told - new.change) ** 2)) < COLOUR_TOLERANCE


def test_a_press_narrows_what_is_possible_where_it_is_and_not_across_the_picture(before, unit):
    after = shading_field.update_field(before, [surface(unit, np.random.default_rng(1), -0.7, -0.4)[0]])

    def spread(fields, x, y):
        at, level = (
            shading_field.compute_position_terms(np.float32([x]), np.float32([y])),
            np.array([[0.3, 0.0, -0.05, 0.0]]),
        )
        drawn = shading_field.sample_fields(fields, 60, np.random.default_rng(2))
        return np.std([shading_field.predict_colours(d, at, level)[0] for d in drawn], axis=0).mean()

    assert spread(after, -0.7, -0.4) < 0.5 * spread(before, -0.7, -0.4)
    assert spread(after, 0.8, 0.6) > 0.5 * spread(before, 0.8, 0.6)


def test_one_spoilt_tenth_of_a_press_pulls_little(before, unit):
    clean, _ = surface(unit, np.random.default_rng(3), 0.0, 0.0)
    dirty = clean.change.copy()
    dirty[::10] += 2.0
    found = [shading_field.update_field(before, [replace(clean, change=c)]).mean for c in (clean.change, dirty)]
    at = shading_field.compute_position_terms(clean.u, clean.v)
    moved = shading_field.predict_colours(found[1], at, clean.shading_terms) - shading_field.predict_colours(
        found[0], at, clean.shading_terms
    )
    assert np.sqrt(np.mean(moved**2)) < 0.1  # a plain mean would move by 0.2


def test_the_look_up_of_a_known_field_finds_slopes_back_whatever_the_indentation(unit):
    look_up = shading_field.fit_slope_model(unit[None], SHAPE, 8000, np.random.default_rng(0))
    new, slopes = surface(unit, np.random.default_rng(4), 0.1, -0.2)
    found = slope_model.predict(
        look_up, SlopeSamples(change=new.change, u=new.u, v=new.v, slopes=slopes.astype(np.float32))
    )
    assert np.sqrt(np.mean((found - slopes) ** 2)) < SLOPE_TOLERANCE


def test_a_sensor_without_optics_has_no_prior():
    with pytest.raises(CalibrationError, match="measures depth itself"):
        near_led_prior.compute_prior(load_sensor("soft_bubble"), PIXEL_MM, SHAPE)
