from __future__ import annotations

import numpy as np
import pytest

from pipeline.core.arrays import freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.geometry import rigid
from pipeline.core.values.results import DepthMap, make_pixel_index
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors.alignment import AXES, resolve_alignment
from pipeline.sensors.spec import load_sensor
from pipeline.translation.alignment.nudge import nudge
from pipeline.translation.alignment.score import (
    UNIT_STEP,
    choose_preview_factor,
    compute_sensitivities,
    find_edge,
    median_score,
    observe_target,
    score_preview,
    score_touches,
)
from pipeline.translation.alignment.touches import AlignmentTouch, find_pivot, load_paired_touch
from pipeline.translation.translate import Request, open_translation
from sample_data.make_samples import RECORDINGS_FOLDER

SOURCE = load_sensor("digit")
TARGET = load_sensor("gelslim")
ALIGNED = resolve_alignment(SOURCE, TARGET)
# both gels bridge the tool's edges a little differently; a GelSlim's pixel is 0.042 mm
SUB_PIXEL_MM = 0.01


def exact_map(spec, truth):
    return DepthMap(
        indentation_mm=truth.indentation_mm,
        depth_mm=freeze((spec.rest_depth_mm - truth.indentation_mm).astype(np.float32)),
        contact=truth.contact,
        camera=spec.camera,
        source_index=make_pixel_index(spec.camera.shape),
    )


@pytest.fixture(scope="module")
def touch():
    pose = rigid.from_parts((-2.0, -1.0, -0.3), (0.5, 0.0, 15.0))
    source, target = (
        simulate_press(shapes.make_shape("notched_elbow").mesh, pose, s, seed=None)
        for s in (SOURCE, TARGET)
    )
    return AlignmentTouch(
        index=0, source=exact_map(SOURCE, source.truth), target=exact_map(TARGET, target.truth)
    )


@pytest.mark.parametrize(("factor", "least_iou"), [(1, 0.95), (4, 0.9)])
def test_the_exact_alignment_scores_nearly_perfectly(touch, factor, least_iou):
    side = observe_target(touch.target, TARGET, factor=factor)
    view, good = score_preview(touch, ALIGNED, side)
    assert view.camera == side.spec.camera
    assert good.iou > least_iou
    assert good.edge_px < 2.0
    assert good.depth_mm < SUB_PIXEL_MM
    assert abs(good.bias_mm) < SUB_PIXEL_MM


@pytest.mark.parametrize("factor", [1, 4])
def test_a_shift_shows_in_depth_edge_and_overlap_by_its_own_size(touch, factor):
    side = observe_target(touch.target, TARGET, factor=factor)
    pivot = find_pivot(touch, ALIGNED)
    lower = score_preview(touch, nudge(ALIGNED, "z", 0.1, pivot_mm=pivot), side)[1]
    assert lower.bias_mm == pytest.approx(0.1, abs=SUB_PIXEL_MM)
    here = score_preview(touch, ALIGNED, side)[1]
    shifted = score_preview(touch, nudge(ALIGNED, "x", 1.0, pivot_mm=pivot), side)[1]
    assert shifted.iou < here.iou - 0.1
    # 1 mm is 24 px, seen on the edges that stand across
    assert shifted.edge_px > here.edge_px + 3.0


def test_sensitivity_says_which_axis_matters_and_which_way_is_better(touch):
    side = observe_target(touch.target, TARGET, factor=4)
    off = nudge(ALIGNED, "z", -0.3, pivot_mm=find_pivot(touch, ALIGNED))
    by_axis = {s.axis: s for s in compute_sensitivities(touch, off, side)}
    assert tuple(by_axis) == AXES
    assert by_axis["z"].depth_mm.slope == pytest.approx(
        -UNIT_STEP, rel=0.2
    )  # too near: 0.1 mm farther is better by as much
    assert by_axis["z"].depth_mm.magnitude > 3.0 * by_axis["x"].depth_mm.magnitude
    at_best = {s.axis: s for s in compute_sensitivities(touch, ALIGNED, side)}
    assert at_best["x"].iou.magnitude > 0.0
    assert (by_axis["rz"].unit, by_axis["x"].unit) == ("deg", "mm")


def test_where_nothing_meets_there_is_no_distance_and_no_error(touch):
    side = observe_target(touch.target, TARGET, factor=4)
    away = nudge(ALIGNED, "x", 500.0, pivot_mm=np.zeros(3))
    lost = score_preview(touch, away, side)[1]
    assert (lost.edge_px, lost.depth_mm, lost.overlap_px) == (None, None, 0)
    for one in compute_sensitivities(touch, away, side):
        assert one.depth_mm.slope is None
        assert one.depth_mm.magnitude is None


def test_the_border_of_the_image_is_no_edge():
    mask = np.zeros((20, 30), np.bool_)
    mask[:10, 5:] = True
    edge = find_edge(mask)
    assert edge[9, 5:].all()
    assert edge[:10, 5].all()
    assert not edge[0, 7:].any()
    assert not edge[:9, -1].any()


def test_scores_of_all_frames_and_what_is_typical(touch):
    side = observe_target(touch.target, TARGET, factor=4)
    several = score_touches([touch, touch], [side, side], ALIGNED)
    assert several[0] == several[1] == median_score(several)
    assert median_score(()) is None


def test_a_factor_below_one_is_refused_and_a_coarse_image_is_shrunk_less(touch):
    with pytest.raises(SettingProblem, match="at least 1"):
        observe_target(touch.target, TARGET, factor=0)
    assert (
        choose_preview_factor(load_sensor("gelslim")),
        choose_preview_factor(load_sensor("soft_bubble")),
    ) == (4, 2)


def test_a_recording_without_the_target_is_refused_in_words():
    opened = open_translation(
        Request(recording=RECORDINGS_FOLDER / "grasps_cross.h5", source="gelslim", target="digit")
    )
    with pytest.raises(SettingProblem, match="digit recorded no frame 0 here"):
        load_paired_touch(opened, 0)
