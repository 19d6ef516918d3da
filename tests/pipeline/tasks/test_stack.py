import math

import pytest

from pipeline.tasks.in_hand import PlanarPose
from pipeline.tasks.stack import compute_nested_mm, measure_off_mm, stack

HELD = PlanarPose(x_mm=1.0, y_mm=-2.0, angle_rad=0.4)


@pytest.mark.parametrize("clearance_mm", [2.0, 4.0, 8.0])
def test_a_known_grasp_nests_where_the_walls_touch(clearance_mm):
    attempt = stack(HELD, HELD, clearance_mm)
    assert attempt.succeeds, attempt.cause
    height_mm = attempt.measures["above_nested_mm"] + compute_nested_mm(clearance_mm)
    assert height_mm == pytest.approx(compute_nested_mm(clearance_mm), abs=4.5)  # 16 flat walls bind earlier than round


def test_a_wide_rim_forgives_a_tilt_that_a_narrow_one_does_not():
    believed = PlanarPose(x_mm=1.0, y_mm=-2.0, angle_rad=0.4 + math.radians(8.0))
    assert stack(HELD, believed, 8.0).succeeds
    assert not stack(HELD, believed, 2.0).succeeds


def test_error_is_the_offset_of_the_bottom():
    assert measure_off_mm(HELD, HELD) == pytest.approx(0.0, abs=1e-9)
    upright = PlanarPose()
    assert measure_off_mm(upright, PlanarPose(y_mm=3.0)) == pytest.approx(3.0)
