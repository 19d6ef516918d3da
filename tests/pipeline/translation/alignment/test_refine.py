from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.core.arrays import freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.geometry import rigid
from pipeline.core.progress import SILENT, Cancelled
from pipeline.core.values.results import DepthMap, make_pixel_index
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors.alignment import compose_motion, correct_alignment, resolve_alignment
from pipeline.sensors.spec import load_sensor
from pipeline.translation.alignment import refine as refining
from pipeline.translation.alignment import residuals
from pipeline.translation.alignment.refine import refine_alignment
from pipeline.translation.alignment.residuals import (
    NormalEquations,
    collect_evidence,
    compute_outline_distances,
    compute_surface_distances,
)
from pipeline.translation.alignment.touches import AlignmentTouch, find_pivot

SOURCE = load_sensor("digit")
TARGET = load_sensor("gelslim")
ALIGNED = resolve_alignment(SOURCE, TARGET)
NEAR_MM = 0.05  # of the exact transform at the contact: one GelSlim pixel
NEAR_DEG = 0.5  # of turning: a pixel at the end of a contact of a few millimetres


def exact_map(spec, truth):
    return DepthMap(
        indentation_mm=truth.indentation_mm,
        depth_mm=freeze((spec.rest_depth_mm - truth.indentation_mm).astype(np.float32)),
        contact=truth.contact,
        camera=spec.camera,
        source_index=make_pixel_index(spec.camera.shape),
    )


def pressed(mesh, pose, index):
    source, target = (simulate_press(mesh, pose, s, seed=None) for s in (SOURCE, TARGET))
    return AlignmentTouch(
        index=index, source=exact_map(SOURCE, source.truth), target=exact_map(TARGET, target.truth)
    )


@pytest.fixture(scope="module")
def touches():
    mesh = shapes.make_shape("notched_elbow").mesh
    poses = ((-3.0, -2.0, 0.0, 0.8), (1.0, 0.5, 60.0, -0.8), (-2.0, 1.0, 150.0, 0.5))
    return [
        pressed(
            mesh,
            rigid.from_parts((x, y, -0.35)) @ rigid.from_parts((0, 0, 0), (tilt, tilt, turn)),
            i,
        )
        for i, (x, y, turn, tilt) in enumerate(poses)
    ]


def disturbed(touch, turn_deg, shift_mm):
    motion = compose_motion(
        find_pivot(touch, ALIGNED), np.deg2rad(turn_deg), np.asarray(shift_mm, np.float64)
    )
    return correct_alignment(ALIGNED, motion)


def error(answer):
    off = answer.alignment.target_from_source @ rigid.invert(ALIGNED.target_from_source)
    return float(
        np.linalg.norm(rigid.apply(off, answer.pivot_mm) - answer.pivot_mm)
    ), rigid.rotation_angle_deg(off)


def test_under_the_exact_alignment_surfaces_meet_and_outlines_are_the_gels_growth_apart(touches):
    for touch in touches:
        made = collect_evidence(touch)
        on = rigid.apply(ALIGNED.target_from_source, made.surface_mm)
        surface = compute_surface_distances(made, on)
        assert len(surface.mm) > 0.5 * surface.n_points
        # both gels lie on one rigid object; what is left is sampling
        assert np.median(np.abs(surface.mm)) < 0.005
        outline = compute_outline_distances(
            made, rigid.apply(ALIGNED.target_from_source, made.outline_mm)
        )
        assert np.median(np.abs(outline.mm)) < NEAR_MM


@pytest.mark.parametrize(("off_px", "n_left"), [(0.25, 4), (-0.25, 0)])
def test_outlines_are_compared_up_to_the_same_distance_from_every_border(touches, off_px, n_left):
    made = collect_evidence(touches[0])
    rows, cols = made.camera.shape
    near = residuals._BORDER_PX + off_px
    x = np.array([near, cols - 1 - near, cols / 2, cols / 2])
    y = np.array([rows / 2, rows / 2, near, rows - 1 - near])
    camera = made.camera
    z = 20.0
    points = np.stack(
        [(x - camera.cx_px) / camera.fx_px * z, (y - camera.cy_px) / camera.fy_px * z, 0 * x + z],
        axis=1,
    )
    distances = compute_outline_distances(made, points)
    assert (distances.n_points, len(distances.mm)) == (4, n_left)


def test_no_step_is_longer_than_the_longest(touches, monkeypatch):
    """Asked for a step of a thousand tolerances, of information that is nearly none, and
    accepted as a good one.
    """
    better = NormalEquations(cost=0.0, gradient=np.zeros(6), information=np.eye(6))
    monkeypatch.setattr(refining, "accumulate_sums", lambda *_: better)
    solver = refining._Solver([], np.eye(4), np.array([0.0, 0.0, 20.0]), SILENT)
    for size in (1e-3, 1e3):
        here = NormalEquations(cost=1.0, gradient=np.full(6, size), information=np.eye(6))
        moved, _, length = solver._step(np.eye(4), here, None, None, np.eye(6), 0.0)
        assert length == pytest.approx(size * np.sqrt(6))
        taken = np.linalg.norm(solver._as_step(moved))
        assert taken == pytest.approx(min(length, refining._MAX_STEP), rel=1e-6)


@pytest.mark.parametrize("kind", [compute_surface_distances, compute_outline_distances])
def test_jacobians_are_those_of_finite_differences(touches, kind):
    made = collect_evidence(touches[0])
    points = rigid.apply(
        ALIGNED.target_from_source,
        made.surface_mm if kind is compute_surface_distances else made.outline_mm,
    )
    points = points + np.array([0.3, 0.2, 0.05])
    here = kind(made, points)
    compared = 0
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 0.02
        up = kind(made, here.points_mm + step)
        down = kind(made, here.points_mm - step)
        if len(up.mm) != len(here.mm) or len(down.mm) != len(here.mm):
            continue
        compared += 1
        slope = (up.mm - down.mm) / 0.04
        # of 1: fields are bilinear and have kinks
        assert np.median(np.abs(slope - here.jacobian[:, axis])) < 0.05
    assert compared >= 2  # a point that leaves the field on the way costs one axis


@pytest.mark.parametrize(
    ("turn_deg", "shift_mm"),
    [((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), ((2.0, -2.0, 4.0), (2.0, -1.8, 1.2))],
)
def test_refining_finds_the_exact_alignment_again(touches, turn_deg, shift_mm):
    start = disturbed(touches[0], turn_deg, shift_mm)
    answer = refine_alignment(touches[:2], start, held_out=touches[2:])
    mm, deg = error(answer)
    assert mm < NEAR_MM
    assert deg < NEAR_DEG
    assert answer.converged
    assert answer.weak_directions == ()
    np.testing.assert_array_equal(
        answer.alignment.alignment_from_source, start.alignment_from_source
    )
    before, after = answer.held_out_fit
    assert after.surface_mm < 0.01  # mm, on a touch that it has never seen
    assert after.outline_mm < NEAR_MM
    if any(shift_mm):
        assert before.outline_mm > 3.0 * after.outline_mm


def test_what_a_bar_does_not_show_is_named_and_left_as_it_was():
    outline = np.array([[-25.0, -1.5], [25.0, -1.5], [25.0, 1.5], [-25.0, 1.5]])
    across = pressed(
        shapes.make_chamfered_prism(outline, 5.0, 0.1, "bar"),
        rigid.from_parts((0.0, 0.0, -0.35)),
        0,
    )
    start = disturbed(across, (0.0, 0.0, 2.0), (0.7, 0.5, 0.1))
    answer = refine_alignment([across], start)
    assert "moves along x" in answer.weak_directions
    off = answer.alignment.target_from_source @ rigid.invert(ALIGNED.target_from_source)
    shift = rigid.apply(off, answer.pivot_mm) - answer.pivot_mm
    assert abs(shift[0] - 0.7) < 0.1  # nothing moved it along the bar: what was off stays off
    assert abs(shift[1]) < NEAR_MM
    assert abs(shift[2]) < NEAR_MM


def test_the_same_touches_give_the_same_bytes(touches):
    start = disturbed(touches[0], (1.0, 0.0, 3.0), (1.0, 0.5, 0.1))
    a = refine_alignment(touches[:2], start)
    b = refine_alignment(touches[:2], start)
    assert a.motion.tobytes() == b.motion.tobytes()


def test_a_distance_does_not_depend_on_opencvs_threads():
    contact = np.random.default_rng(0).random((320, 427)) > 0.99
    before = cv2.getNumThreads()
    try:
        found = []
        for n_threads in (1, 2):
            cv2.setNumThreads(n_threads)
            found.append(residuals._outside_px(contact).tobytes())
    finally:
        cv2.setNumThreads(before)
    assert found[0] == found[1]


def test_refining_stops_when_nobody_wants_it(touches):
    class Impatient:
        def step(self, fraction, text):
            raise Cancelled

    with pytest.raises(Cancelled):
        refine_alignment(touches, ALIGNED, progress=Impatient())


def test_without_a_touch_on_both_sides_there_is_nothing_to_refine(touches):
    nothing = touches[0].source
    empty = DepthMap(
        indentation_mm=nothing.indentation_mm,
        depth_mm=nothing.depth_mm,
        camera=nothing.camera,
        contact=freeze(np.zeros_like(nothing.contact)),
        source_index=nothing.source_index,
    )
    with pytest.raises(SettingProblem, match="tolerance"):
        refine_alignment([touches[0]], ALIGNED, tolerance=0.0)
    with pytest.raises(SettingProblem, match="both sensors"):
        refine_alignment([AlignmentTouch(index=0, source=empty, target=touches[0].target)], ALIGNED)
