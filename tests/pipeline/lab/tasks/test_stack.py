import math

import pytest

from pipeline.lab.tasks.grasp import PlanarPose
from pipeline.lab.tasks.stack import measure_off_mm, stack

HELD = PlanarPose(x_mm=1.0, y_mm=-2.0, angle_rad=0.4)


@pytest.mark.parametrize(("clearance_mm", "above_mm"), [(2.0, 3.40), (4.0, 3.76), (8.0, 4.21)])
def test_a_known_grasp_nests_where_the_walls_touch(clearance_mm, above_mm):
    """Sixteen flat walls bind earlier than round ones, by the same height for the same
    clearance.
    """
    attempt = stack(HELD, HELD, clearance_mm)
    assert attempt.succeeds, attempt.cause
    assert attempt.measures["above_nested_mm"] == pytest.approx(above_mm, abs=0.05)


def test_a_wide_rim_forgives_a_tilt_that_a_narrow_one_does_not():
    believed = PlanarPose(x_mm=1.0, y_mm=-2.0, angle_rad=0.4 + math.radians(8.0))
    assert stack(HELD, believed, 8.0).succeeds
    assert not stack(HELD, believed, 2.0).succeeds


def test_error_is_the_offset_of_the_bottom():
    assert measure_off_mm(HELD, HELD) == pytest.approx(0.0, abs=1e-9)
    upright = PlanarPose()
    assert measure_off_mm(upright, PlanarPose(y_mm=3.0)) == pytest.approx(3.0)
