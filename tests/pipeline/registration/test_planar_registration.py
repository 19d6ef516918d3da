from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.base.errors import SettingProblem, ShapeError
from pipeline.base.progress import Cancelled
from pipeline.geometry import rigid
from pipeline.registration.planar import (
    N_MODEL,
    SWEEP_DEG,
    Planar,
    angle_score,
    model_cloud,
    planar_registration,
    starts,
)
from tests.pipeline.registration.solids import l_bar, rod

ANGLE_DEG = 3.0  # points within a filled face find partners wherever they are; the release reports 1.4 +- 1.1
SHIFT_MM = 0.5  # for the same reason
Z = Planar(axis="z", n_iterations=200)


def l_face(n: int = 900):
    """Points on the flat side of the L at z = 4, the whole of it."""
    rng = np.random.default_rng(2)
    points = np.column_stack([rng.uniform(0, 12, 4 * n), rng.uniform(0, 9, 4 * n), np.full(4 * n, 4.0)])
    return points[(points[:, 0] < 3) | (points[:, 1] < 3)][:n]


def about_z(deg: float, x_mm: float = 0.0, y_mm: float = 0.0):
    return rigid.translation(x_mm, y_mm, 0.0) @ rigid.rotation([0.0, 0.0, math.radians(deg)])


@pytest.mark.parametrize("deg", [-12.0, 4.0, 15.0])
def test_an_l_is_found_from_nearby(deg):
    truth = about_z(deg, 0.8, -0.5)
    fit = planar_registration(model_cloud(l_bar().mesh), rigid.apply(truth, l_face()), Z)
    assert fit.angle_deg == pytest.approx(deg, abs=ANGLE_DEG)
    np.testing.assert_allclose(fit.shift_mm, truth[:2, 3], atol=SHIFT_MM)
    assert fit.fitness == 1.0
    assert fit.start_deg == 0.0


@pytest.mark.parametrize("how", ["sweep", "random"])
def test_several_starts_are_no_worse_by_their_own_measure(how):
    truth = about_z(20.0, 3.0, 1.0)
    model, scene = model_cloud(l_bar().mesh), rigid.apply(truth, l_face())
    one = planar_registration(model, scene, Planar(axis="z", n_iterations=20))
    several = planar_registration(model, scene, Planar(axis="z", n_iterations=20, starts=how))
    assert several.inlier_rmse_mm <= one.inlier_rmse_mm + 0.01
    assert several.angle_deg == pytest.approx(20.0, abs=ANGLE_DEG)


@pytest.mark.parametrize(("axis", "to_axis"), [("x", [2, 0, 1]), ("y", [1, 2, 0]), ("z", [0, 1, 2])])
def test_each_axis_of_projection_is_the_same_registration_turned(axis, to_axis):
    scene = rigid.apply(about_z(8.0, 0.4, 0.3), l_face())
    model = np.array(model_cloud(l_bar().mesh))
    plain = planar_registration(model, scene, Z)
    turned = planar_registration(model[:, to_axis], scene[:, to_axis], Planar(axis=axis))
    assert turned.angle_deg == pytest.approx(plain.angle_deg, abs=1e-9)
    np.testing.assert_allclose(turned.shift_mm, plain.shift_mm, atol=1e-9)


def test_a_rod_that_was_slid_stays_slid_and_looks_perfect():
    """The documented failure: many-to-one pairs along a rod pull nowhere, and the residual says that all is well."""
    model = model_cloud(rod(length_mm=40.0).mesh)
    rng = np.random.default_rng(0)
    angle, along = rng.uniform(-0.9, 0.9, 800), rng.uniform(-4.0, 4.0, 800)
    patch = np.column_stack([along, 3.0 * np.sin(angle), 3.0 * np.cos(angle)])
    slid_mm = 3.0
    fit = planar_registration(
        rigid.apply(rigid.translation(slid_mm, 0, 0), model), patch, Planar(axis="z", keep_steps=True)
    )
    assert slid_mm + fit.shift_mm[0] > 0.9 * slid_mm, "it is still there"
    assert fit.steps[-1].rmse_mm < 0.15, "mm, the samples' spacing: nothing to see"


def test_steps_end_at_the_answer_and_do_not_change_it():
    scene = rigid.apply(about_z(10.0), l_face())
    model, placed = model_cloud(l_bar().mesh), rigid.translation(0.2, 0.1, 5.0)
    kept = planar_registration(model, scene, Planar(axis="z", keep_steps=True), placed=placed)
    plain = planar_registration(model, scene, Z, placed=placed)
    assert kept.scene_from_model.tobytes() == plain.scene_from_model.tobytes()
    np.testing.assert_array_equal(kept.steps[-1].scene_from_model, kept.scene_from_model)
    assert plain.steps == ()
    assert kept.scene_from_model[2, 3] == 5.0, "what lies along the axis is left as it was placed"
    assert kept.steps[0].rmse_mm > kept.steps[-1].rmse_mm


def test_random_starts_are_the_same_every_time():
    model, scene = model_cloud(l_bar().mesh), rigid.apply(about_z(10.0), l_face())
    how = Planar(axis="z", n_iterations=5, starts="random", seed=3)
    one, two = planar_registration(model, scene, how), planar_registration(model, scene, how)
    assert one.scene_from_model.tobytes() == two.scene_from_model.tobytes()
    other = starts(Planar(starts="random", seed=4))
    assert not np.array_equal(starts(how), other)
    assert len(other) == 10
    assert np.abs(np.array(other)[:, :2, 2]).max() <= 10.0
    angles = [np.degrees(np.arctan2(motion[1, 0], motion[0, 0])) for motion in other]
    np.testing.assert_allclose(np.array(angles) / 5.0 % 1.0, 0.5, atol=1e-9)  # 2.5 beside multiples of 5


def test_the_models_cloud_and_the_sweep_are_those_of_the_release():
    assert model_cloud(l_bar().mesh).shape == (N_MODEL, 3) == (5000, 3)
    assert SWEEP_DEG[0] == -SWEEP_DEG[-1] == -22.5
    assert np.diff(SWEEP_DEG) == pytest.approx(5.0)


def test_three_points_are_no_touch():
    fit = planar_registration(model_cloud(l_bar().mesh), l_face()[:3], Z)
    np.testing.assert_array_equal(fit.scene_from_model, np.eye(4))
    assert "only 3 felt points" in fit.notes[0]


@given(deg=st.floats(-179.0, 179.0), x=st.floats(-9.0, 9.0), y=st.floats(-9.0, 9.0))
@settings(max_examples=25, deadline=None)
def test_from_the_right_place_an_exact_copy_stays(deg, x, y):
    truth = about_z(deg, x, y)
    cloud = l_face(60)
    fit = planar_registration(cloud, rigid.apply(truth, cloud), Z, placed=truth)
    np.testing.assert_allclose(fit.scene_from_model, truth, atol=1e-9)
    assert fit.inlier_rmse_mm < 1e-9


def test_the_score_with_and_without_wrapping_round():
    found, true = np.array([359.0, 4.0, -12.0]), np.array([1.0, 0.0, 0.0])
    released, right = angle_score(found, true, wrap=False), angle_score(found, true, wrap=True)
    assert released.mean_deg == pytest.approx((358 + 4 + 12) / 3)
    assert right.mean_deg == pytest.approx((2 + 4 + 12) / 3)
    assert (released.within_5_deg, right.within_5_deg) == pytest.approx((1 / 3, 2 / 3))
    assert right.within_10_deg == pytest.approx(2 / 3)
    with pytest.raises(ShapeError, match="at least one"):
        angle_score(np.empty(0), np.empty(0), wrap=True)


def test_wrong_clouds_and_settings_are_refused_and_nobody_waits_in_vain():
    cloud = l_face(20)
    with pytest.raises(ShapeError, match="model"):
        planar_registration(cloud[:0], cloud, Z)
    with pytest.raises(ShapeError, match="scene"):
        planar_registration(cloud, cloud * np.nan, Z)
    with pytest.raises(SettingProblem, match="iteration"):
        planar_registration(cloud, cloud, Planar(n_iterations=0))

    class Impatient:
        def step(self, fraction, text):
            if fraction > 0:
                raise Cancelled

    with pytest.raises(Cancelled):
        planar_registration(cloud, cloud, Planar(axis="z", starts="sweep"), Impatient())
