"""Random gel units and what their cameras record."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.simulation.gel_images import NO_DRIFT, render_image_pair, sample_drift
from pipeline.simulation.random_gel_sensors import sample_gel_sensor


def dent(depth_mm, shape):
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    radius_sq, r_sq = (0.15 * min(shape)) ** 2, (x - shape[1] / 2) ** 2 + (y - shape[0] / 2) ** 2
    return (depth_mm * np.exp(-r_sq / radius_sq)).astype(np.float32), r_sq < 0.5 * radius_sq


def shot(seed, depth_mm, drifted=NO_DRIFT):
    rng = np.random.default_rng(seed)
    of = sample_gel_sensor(rng)
    surface, contact = dent(depth_mm, of.nominal.camera.shape)
    return (*render_image_pair(rng, of, surface, contact if depth_mm else contact & False, drifted), of)


def test_the_same_seed_gives_the_same_pictures():
    for first, again in zip(shot(5, 0.5)[:2], shot(5, 0.5)[:2], strict=True):
        assert np.array_equal(first, again)


@pytest.mark.parametrize("seed", range(12))
def test_pictures_are_grey_levels_and_a_touch_shows_where_it_is(seed):
    touched, untouched, of = shot(seed, 1.2)
    rows, cols = of.nominal.camera.shape
    for picture in (touched, untouched):
        assert picture.shape == (rows, cols, 3)
        assert picture.dtype == np.uint8
    change = np.abs(touched.astype(np.float32) - untouched).mean(axis=2)
    middle = change[rows * 3 // 10 : rows * 7 // 10, cols * 3 // 10 : cols * 7 // 10]
    assert middle.mean() > change[: rows // 6].mean()


def test_units_differ_in_kind_in_light_and_from_what_is_known_of_them():
    of = [sample_gel_sensor(np.random.default_rng(seed)) for seed in range(60)]
    assert len({one.nominal.name for one in of}) == 4
    assert all(one.sensor.optics != one.nominal.optics for one in of)
    dotted = [one.sensor.markers is not None for one in of if one.nominal.markers is None]
    assert 0 < sum(dotted) < len(dotted) / 2
    assert any(one.sensor.markers != one.nominal.markers for one in of if one.nominal.name == "gelslim")
    bright = [float(one.reference_light.mean()) for one in of]
    assert max(bright) > 2 * min(bright)


def off(a, b):
    return np.abs(a.astype(np.float32) - b).mean()


def test_drift_alone_changes_an_untouched_picture_and_no_drift_does_not():
    drifted = sample_drift(np.random.default_rng(1), 1.0)
    still, moved = shot(3, 0.0), shot(3, 0.0, drifted)
    assert off(*still[:2]) < off(*moved[:2])
