from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.geometry.symmetry import cyclic
from pipeline.core.values.frames import Truth
from pipeline.core.values.results import ObjectPose
from pipeline.stages.metrics.stage_metrics import (
    METRICS,
    PSNR_CAP_DB,
    compute_mae_mm,
    compute_pose_metrics,
    describe_metric,
    iou,
    psnr_db,
)

MASKS = hnp.arrays(np.bool_, (4, 5))


@given(MASKS, MASKS)
def test_iou_is_symmetric_and_one_only_for_equal_masks(a, b):
    assert iou(a, b) == iou(b, a)
    assert 0.0 <= iou(a, b) <= 1.0
    assert (iou(a, b) == 1.0) == bool((a == b).all())


def test_mean_error_leaves_out_missing_values_and_says_nan_when_none_is_left():
    estimate = np.array([[1.0, np.nan]])
    truth = np.array([[0.5, 0.0]])
    assert compute_mae_mm(estimate, truth, np.array([[True, True]])) == 0.5
    assert math.isnan(compute_mae_mm(estimate, truth, np.array([[False, True]])))


@given(st.integers(1, 50))
def test_psnr_of_a_known_offset_is_the_textbook_value(offset):
    a = np.full((3, 3, 3), 100, np.uint8)
    assert psnr_db(a, a + np.uint8(offset), 255.0) == pytest.approx(20 * math.log10(255 / offset))
    assert psnr_db(a, a, 255.0) == PSNR_CAP_DB


def test_pose_error_is_stated_at_the_contact_not_at_a_far_away_origin():
    scene = np.array([[0.0, 0, 20], [1, 0, 20], [0, 1, 20], [-1, -1, 20]], np.float32)
    truth = rigid.translation(0, 0, 1020)  # the object's origin is a metre behind the contact
    centre = rigid.translation(*scene.mean(axis=0))
    turned = centre @ rigid.rotation([0.01, 0, 0]) @ rigid.invert(centre) @ truth
    pose = ObjectPose(
        sensor_from_object=turned,
        covariance=None,
        observable=None,
        weak_directions=(),
        rmse_mm=0.0,
        fitness=1.0,
        scene_mm=scene,
        source_index=np.arange(4, dtype=np.int32),
    )
    figures = compute_pose_metrics(pose, Truth(sensor_from_object=truth))
    assert figures["translation_mm"] == pytest.approx(0.0, abs=1e-6)
    assert figures["rotation_deg"] == pytest.approx(math.degrees(0.01), rel=1e-6)


def test_pose_errors_after_symmetry_stand_beside_the_plain_ones_once_the_mesh_is_known():
    scene = np.array([[0.0, 0, 20], [1, 0, 20], [0, 1, 20], [-1, -1, 20]], np.float32)
    truth = rigid.translation(0, 0, 22)
    slide = np.diag([1.0, 1, 1, 0, 1, 1])
    pose = ObjectPose(
        sensor_from_object=rigid.translation(2, 0.1, 0) @ truth @ rigid.rotation([0, 0, math.pi]),
        covariance=None,
        observable=slide,  # all but a slide along x
        weak_directions=("moves along x",),
        rmse_mm=0.0,
        fitness=1.0,
        scene_mm=scene,
        source_index=np.arange(4, dtype=np.int32),
    )
    bar = Mesh(
        vertices_mm=np.array([[-9.0, 0, 0], [9, 0, 0], [0, 0, 3]]),
        triangles=np.array([[0, 1, 2]], np.int32),
    )
    known = Truth(sensor_from_object=truth)
    figures = compute_pose_metrics(pose, known, bar, cyclic(2))
    assert figures["rotation_deg"] == pytest.approx(180.0)
    assert figures["mssd_mm"] == pytest.approx(math.hypot(2, 0.1))
    assert figures["se2_mm"] == pytest.approx(math.hypot(2, 0.1))
    assert figures["se2_deg"] == pytest.approx(0.0, abs=1e-6)
    assert figures["observable_mm"] == pytest.approx(0.1)
    assert figures["observable_deg"] == pytest.approx(0.0, abs=1e-6)
    unknown = compute_pose_metrics(pose, known, bar)
    assert unknown["mssd_mm"] > 17.0, "the ends of the bar are taken as different"
    assert "mssd_mm" not in compute_pose_metrics(pose, known)
    assert figures.keys() <= METRICS.keys(), "every figure says its unit and which way is better"


def test_figures_have_a_name_for_people_and_no_two_have_one():
    assert describe_metric("touch_depth.contact_mae_mm") == "touch depth: error in contact, mm"
    assert describe_metric("touch_depth.contact_iou") == "touch depth: IoU of contact"
    assert len({metric.title for metric in METRICS.values()}) == len(METRICS)
