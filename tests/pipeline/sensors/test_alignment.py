from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from pipeline.core.geometry import rigid
from pipeline.sensors.alignment import resolve_alignment
from pipeline.sensors.spec import list_sensor_names, load_sensor


@pytest.mark.parametrize(("source", "target"), list(product(list_sensor_names(), repeat=2)))
def test_an_alignment_and_its_reverse_compose_to_the_identity(source, target):
    there = resolve_alignment(load_sensor(source), load_sensor(target)).target_from_source
    back = resolve_alignment(load_sensor(target), load_sensor(source)).target_from_source
    np.testing.assert_allclose(back @ there, np.eye(4), atol=1e-12)


@pytest.mark.parametrize("name", list_sensor_names())
def test_a_sensor_is_aligned_with_itself(name):
    np.testing.assert_allclose(
        resolve_alignment(load_sensor(name), load_sensor(name)).target_from_source,
        np.eye(4),
        atol=1e-12,
    )


def test_target_from_source_goes_through_the_alignment_frame():
    gel = load_sensor("gelslim")
    bubble = load_sensor("soft_bubble")
    middle_of_gel = [0.0, 0.0, gel.rest_depth_mm.mean()]
    in_alignment = rigid.apply(gel.alignment_from_sensor, middle_of_gel)
    expected = rigid.apply(rigid.invert(bubble.alignment_from_sensor), in_alignment)
    np.testing.assert_allclose(
        rigid.apply(resolve_alignment(gel, bubble).target_from_source, middle_of_gel),
        expected,
        atol=1e-12,
    )
