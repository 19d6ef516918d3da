"""Derived values: computed once for equal contents, in one cache that is bounded in bytes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.core.derived import DERIVED, derive_once
from pipeline.core.memo import measure_bytes
from pipeline.physics import optics
from pipeline.sensors.spec import load_sensor


def test_equal_arguments_give_the_first_object_and_others_their_own():
    asked = []

    @derive_once
    def scale(array, by: float, *, shift=0):
        asked.append(by)
        return array * by + shift

    ones = np.ones(3)
    first = scale(ones, 2.0)
    assert scale(np.ones(3), 2.0) is first
    assert np.array_equal(scale(ones, 3.0), [3.0, 3.0, 3.0])
    assert np.array_equal(scale(ones, 2.0, shift=1), [3.0, 3.0, 3.0])
    assert np.array_equal(scale(2 * ones, 2.0), [4.0, 4.0, 4.0])
    assert asked == [2.0, 3.0, 2.0, 2.0]


def test_a_value_may_be_none():
    asked = []

    @derive_once
    def find(name):
        asked.append(name)

    assert find("missing") is find("missing") is None
    assert asked == ["missing"]


def test_functions_do_not_share_values():
    assert derive_once(lambda n: n + 1)(1) == 2
    assert derive_once(lambda n: n - 1)(1) == 0


def test_a_sensor_that_is_equal_by_content_has_the_same_reference_image():
    sensor = load_sensor("digit")
    image = optics.render_reference(sensor)
    assert (
        optics.render_reference(replace(sensor, rest_depth_mm=sensor.rest_depth_mm.copy())) is image
    )
    assert optics.render_reference(replace(sensor, markers=None)).shape == image.shape
    assert DERIVED.n_bytes >= measure_bytes(image)
    assert DERIVED.n_bytes <= DERIVED.most_bytes
