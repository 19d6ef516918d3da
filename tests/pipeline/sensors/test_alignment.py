from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from pipeline.geometry import rigid
from pipeline.sensors.alignment import between
from pipeline.sensors.spec import names, sensor


@pytest.mark.parametrize(("source", "target"), list(product(names(), repeat=2)))
def test_there_and_back_is_nothing(source, target):
    there = between(sensor(source), sensor(target)).target_from_source
    back = between(sensor(target), sensor(source)).target_from_source
    np.testing.assert_allclose(back @ there, np.eye(4), atol=1e-12)


@pytest.mark.parametrize("name", names())
def test_a_sensor_is_aligned_with_itself(name):
    np.testing.assert_allclose(between(sensor(name), sensor(name)).target_from_source, np.eye(4), atol=1e-12)


def test_the_way_goes_through_the_alignment_frame():
    gel, bubble = sensor("gelslim"), sensor("soft_bubble")
    middle_of_gel = [0.0, 0.0, gel.rest_depth_mm.mean()]
    in_alignment = rigid.apply(gel.alignment_from_sensor, middle_of_gel)
    expected = rigid.apply(rigid.invert(bubble.alignment_from_sensor), in_alignment)
    np.testing.assert_allclose(
        rigid.apply(between(gel, bubble).target_from_source, middle_of_gel), expected, atol=1e-12
    )
