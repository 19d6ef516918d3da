"""A pose followed from the last touch equals a searched one; where the object has jumped, or
another of its poses has come to fit, a search answers.
"""

from dataclasses import replace
from threading import get_ident

import pytest

from pipeline.stages.pose.registration.search import PoseSearch
from pipeline.stages.pose.signed_distances import PoseParams, estimate_or_track_pose, estimate_pose
from pipeline.stages.pose.warm_start import FOLLOWED
from tests.pipeline.stages.pose.registration.solids import (
    extruded,
    l_bar,
    notched_wedge,
    observe_depth,
)
from tests.pipeline.stages.test_pose import error, lying

PARAMS = PoseParams()
SAME_MM = 0.01  # of a followed and a searched pose
SAME_DEG = 0.1


def place(step, angle_deg=30.0):
    return lying(0.3 + 0.1 * step, 0.2, 0.8, 2.0, angle_deg + step)


def test_a_slow_slide_is_followed_to_where_a_search_ends():
    wedge = notched_wedge()
    pose = estimate_pose(observe_depth(wedge, place(0)), wedge.mesh, PARAMS)
    for step in (1, 2, 3):
        touch = observe_depth(wedge, place(step))
        pose = estimate_or_track_pose(touch, wedge.mesh, pose, PARAMS)
        searched = estimate_pose(touch, wedge.mesh, PARAMS)
        mm, deg = error(pose, searched.sensor_from_object)
        assert mm < SAME_MM
        assert deg < SAME_DEG
        assert pose.notes[-1] == FOLLOWED
        assert pose.covariance == pytest.approx(searched.covariance, rel=0.05, abs=1e-7)


def test_a_touch_that_determines_the_pose_is_registered_once(monkeypatch):
    wedge = notched_wedge()
    pose = estimate_pose(observe_depth(wedge, place(0)), wedge.mesh, PARAMS)
    touch = observe_depth(wedge, place(1))
    tried = []
    polish = PoseSearch.polish
    monkeypatch.setattr(
        PoseSearch, "polish", lambda *a, **k: tried.append(get_ident()) or polish(*a, **k)
    )
    found = estimate_or_track_pose(touch, wedge.mesh, pose, PARAMS)
    assert found.notes[-1] == FOLLOWED
    assert not found.weak_directions
    assert tried.count(get_ident()) == 1


@pytest.mark.parametrize("angle_deg", [36.0, 150.0])
def test_a_jump_is_not_followed(angle_deg):
    wedge = notched_wedge()
    before = estimate_pose(observe_depth(wedge, place(0)), wedge.mesh, PARAMS)
    truth = place(15, angle_deg)
    found = estimate_or_track_pose(observe_depth(wedge, truth), wedge.mesh, before, PARAMS)
    mm, deg = error(found, truth)
    assert FOLLOWED not in found.notes
    assert mm < 0.1
    assert deg < 1.0


def test_poses_that_fit_as_well_move_along():
    corners = [(-4, -2), (4, -2), (4, 2), (-4, 2)]
    box = extruded(corners, [corners], 0.0, 6.0)
    params = PoseParams(face="+z")
    before = estimate_pose(observe_depth(box, lying(1.3, -0.9, 0.5, 6.0, 17.0)), box.mesh, params)
    touch = observe_depth(box, lying(1.5, -0.9, 0.5, 6.0, 19.0))
    found = estimate_or_track_pose(touch, box.mesh, before, params)
    searched = estimate_pose(touch, box.mesh, params)
    assert FOLLOWED in found.notes
    assert len(found.alternatives) == len(searched.alternatives) == 1
    apart = [error(found, pose) for pose in (searched.sensor_from_object, searched.alternatives[0])]
    assert min(deg for _, deg in apart) < 1.0


def test_a_touch_that_decides_between_poses_ends_the_following():
    bar = l_bar()
    truth = lying(1.0, -0.5, 0.6, 4.0, 20.0, tilt_deg=(1.5, -2.0), origin_mm=(5.0, 3.5))
    wrong = lying(1.0, -0.5, 0.6, 4.0, 200.0, tilt_deg=(1.5, -2.0), origin_mm=(5.0, 3.5))
    touch = observe_depth(bar, truth)
    before = replace(
        estimate_pose(touch, bar.mesh, PARAMS), sensor_from_object=wrong, alternatives=(truth,)
    )
    found = estimate_or_track_pose(touch, bar.mesh, before, PARAMS)
    assert FOLLOWED not in found.notes
    assert error(found, truth)[0] < 0.1
