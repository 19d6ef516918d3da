"""Random gel units and what their cameras record."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.sensors.spec import sensor
from pipeline.simulation.gel_pictures import STILL, drift, pictures
from pipeline.simulation.gel_units import COLS, PIXEL_MM, ROWS, mirrored, unit


def dent(depth_mm, radius_px=20.0):
    y, x = np.mgrid[:ROWS, :COLS].astype(np.float32)
    r_sq = (x - 80) ** 2 + (y - 60) ** 2
    return (depth_mm * np.exp(-r_sq / radius_px**2)).astype(np.float32), r_sq < (0.7 * radius_px) ** 2


def shot(seed, depth_mm, drifted=STILL):
    rng = np.random.default_rng(seed)
    of = unit(rng)
    surface, contact = dent(depth_mm)
    return (*pictures(rng, of, surface, contact if depth_mm else contact & False, drifted), of)


def test_the_same_seed_gives_the_same_pictures():
    for first, again in zip(shot(5, 0.5)[:2], shot(5, 0.5)[:2], strict=True):
        assert np.array_equal(first, again)


@pytest.mark.parametrize("seed", range(12))
def test_pictures_are_grey_levels_and_a_touch_shows_where_it_is(seed):
    touched, untouched, _ = shot(seed, 1.2)
    for picture in (touched, untouched):
        assert picture.shape == (ROWS, COLS, 3)
        assert picture.dtype == np.float32
        assert 0 <= picture.min() <= picture.max() <= 255
    change = np.abs(touched - untouched).mean(axis=2)
    assert change[35:85, 55:105].mean() > change[:20].mean()


def test_units_differ_in_light_and_in_what_is_known_of_it():
    of = [unit(np.random.default_rng(seed)) for seed in range(150)]
    assert len({len(one.sensor.optics.leds) for one in of}) > 4
    assert 0 < sum(one.nominal is None for one in of) < 20
    assert 25 < sum(one.sensor.markers is not None for one in of) < 125
    bright = [float(one.still.mean()) for one in of]
    assert max(bright) > 2 * min(bright)


def test_drift_alone_changes_an_untouched_picture_and_no_drift_does_not():
    drifted = drift(np.random.default_rng(1), 1.0)
    still, moved = shot(3, 0.0), shot(3, 0.0, drifted)
    assert np.abs(still[0] - still[1]).mean() < np.abs(moved[0] - moved[1]).mean()


def test_light_mirrored_at_the_diagonal_is_the_light_of_the_mirrored_sensor():
    digit = sensor("digit").optics
    assert mirrored(mirrored(digit)) == digit
    assert [led.azimuth_deg for led in mirrored(digit).leds] == [(90 - led.azimuth_deg) % 360 for led in digit.leds]
    assert PIXEL_MM * COLS == 20.0
