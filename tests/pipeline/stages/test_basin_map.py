"""Basin maps: where registrations end from starts around a pose."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.base.errors import SettingProblem
from pipeline.base.progress import Cancelled
from pipeline.geometry import rigid
from pipeline.registration.basin_map import NO_MINIMUM, make_start_grid, map_basins
from pipeline.stages.pose.basin_map import compute_basin_map
from pipeline.stages.pose.signed_distances import PoseParams, estimate_pose, prepare_search, skip_without_contact
from tests.pipeline.registration.solids import extruded, l_bar, observe_depth
from tests.pipeline.stages.test_pose import lying

SQUARE = [(-2.5, -2.5), (2.5, -2.5), (2.5, 2.5), (-2.5, 2.5)]
TURNS, SHIFTS = np.array([-90.0, -15.0, 0.0, 15.0, 90.0]), np.array([-0.5, 0.0, 0.5])


def mapped(solid, truth):
    touch, params = observe_depth(solid, truth), PoseParams()
    found = estimate_pose(touch, solid.mesh, params)
    search, _ = prepare_search(touch, solid.mesh, params)
    return map_basins(search, found.sensor_from_object, TURNS, SHIFTS, "x")


def test_starts_are_rotated_about_the_normal_and_translated_in_the_plane():
    touch = observe_depth(l_bar(), lying(0.5, 0.5, 0.6, 4.0, 30.0, origin_mm=(5.0, 3.5)))
    search, _ = prepare_search(touch, l_bar().mesh, PoseParams())
    own = lying(0.5, 0.5, 0.6, 4.0, 30.0, origin_mm=(5.0, 3.5))
    starts = make_start_grid(search, own, TURNS, SHIFTS, "y")
    assert starts.shape == (3, 5, 4, 4)
    assert starts[1, 2] == pytest.approx(own)
    moved = starts[2, 4] @ rigid.invert(own)
    assert rigid.rotation_angle_deg(moved) == pytest.approx(90.0, abs=1e-6)
    off = rigid.apply(moved, search.middle_mm) - search.middle_mm
    assert np.linalg.norm(off) == pytest.approx(0.5)
    assert abs(off[1]) > 0.49


def test_a_square_has_four_equally_good_poses():
    of = mapped(extruded(SQUARE, [SQUARE], 0.0, 4.0), lying(0.3, -0.2, 0.6, 4.0, 10.0))
    at = of.minimum_index[1]
    assert at[2] == 0
    assert {int(at[0]), int(at[2]), int(at[4])} == {0, int(at[0]), int(at[4])}
    assert len({int(at[0]), int(at[2]), int(at[4])}) == 3  # a quarter of a turn away is another pose,
    assert all(of.minima[int(k)].fits_equally for k in (at[0], at[4]))  # which the touch does not tell from the first
    assert of.rmse_mm[1, [0, 2, 4]] == pytest.approx(of.rmse_mm[1, 2], abs=2e-3)
    assert "fit equally well" in of.summary
    turned = of.poses[1, 4] @ rigid.invert(of.poses[1, 2])
    assert rigid.rotation_angle_deg(turned) == pytest.approx(90.0, abs=1.0)


def test_starts_near_the_pose_of_an_l_bar_reach_it():
    of = mapped(l_bar(), lying(1.0, -0.5, 0.6, 4.0, 20.0, tilt_deg=(1.5, -2.0), origin_mm=(5.0, 3.5)))
    assert of.safe_range[0] >= 15.0
    assert of.safe_range[1] >= 0.5
    assert sum(answer.fits_equally for answer in of.minima) == 1
    assert sum(answer.n_starts for answer in of.minima) == np.count_nonzero(of.minimum_index != NO_MINIMUM)
    assert np.isfinite(of.rmse_mm[of.minimum_index != NO_MINIMUM]).all()


def test_no_pose_raises_the_reason_and_the_map_can_be_cancelled():
    truth = lying(0.0, 0.0, 0.6, 4.0, 0.0)
    touch = observe_depth(l_bar(), truth)
    with pytest.raises(SettingProblem, match="no object mesh"):
        compute_basin_map(touch, None, skip_without_contact(touch, None, PoseParams()), PoseParams())

    class Stopped:
        def step(self, fraction: float, text: str) -> None:
            if fraction > 0.5:
                raise Cancelled

    with pytest.raises(Cancelled):
        compute_basin_map(
            touch, l_bar().mesh, estimate_pose(touch, l_bar().mesh, PoseParams()), PoseParams(), progress=Stopped()
        )
