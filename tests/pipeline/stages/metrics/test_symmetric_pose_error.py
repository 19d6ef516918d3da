from __future__ import annotations

import math

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.errors import FileProblem
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.geometry.symmetry import asymmetric, cyclic, revolution
from pipeline.core.values.frames import TactileFrame
from pipeline.io import open_recording
from pipeline.io.hdf5_writer import RecordingWriter
from pipeline.lab import recorder
from pipeline.physics.simulation import datasets, shapes
from pipeline.stages.metrics.stage_metrics import (
    compute_ambiguity,
    compute_in_plane_error,
    compute_observable_error,
    compute_symmetric_error,
    remove_axis_rotation,
)
from pipeline.stages.pose.registration.observability import assess_observability

ROUNDING_MM = 1e-9
SEARCHED_MM = 1e-4  # what golden sections between the steps of a symmetry leave of a 30 mm object
AT_MM = np.array([1.0, -2.0, 20.0])
TURNS = st.tuples(*[st.floats(-3.0, 3.0)] * 3)


def mssd_mm(estimate, truth, mesh, symmetry):
    return compute_symmetric_error(estimate, truth, mesh, symmetry, np.zeros(3)).mssd_mm


def rod(radius_mm=2.0, half_mm=15.0, sides=120):
    """A round rod along x about the origin; only the vertices matter here."""
    angle = np.arange(sides) * 2 * math.pi / sides
    ring = radius_mm * np.stack([np.zeros(sides), np.cos(angle), np.sin(angle)], axis=1)
    end = np.array([half_mm, 0.0, 0.0])
    vertices = np.concatenate([ring + end, ring - end])
    return Mesh(vertices_mm=vertices, triangles=np.zeros((1, 3), np.int32))


BOX = Mesh(
    vertices_mm=np.array([[x, y, z] for x in (-4.0, 4.0) for y in (-2.0, 2.0) for z in (0.0, 6.0)]),
    triangles=np.zeros((1, 3), np.int32),
)
ROD_TURNS = revolution((1.0, 0.0, 0.0), flip=(0.0, 0.0, 1.0))


def pose(turn, shift=(1.0, -2.0, 20.0)):
    made = rigid.rotation(turn)
    made[:3, 3] = shift
    return made


@given(turn=TURNS, roll=st.floats(-3.1, 3.1), flip=st.booleans())
@settings(max_examples=25)
def test_a_rod_rolled_or_turned_end_for_end_is_where_it_was(turn, roll, flip):
    truth = pose(turn)
    same = (
        truth
        @ rigid.rotation([roll, 0, 0])
        @ (rigid.rotation([0, 0, math.pi]) if flip else np.eye(4))
    )
    error = compute_symmetric_error(same, truth, rod(), ROD_TURNS, AT_MM, np.eye(6))
    assert error.mssd_mm < SEARCHED_MM
    assert error.se2_mm < SEARCHED_MM
    assert error.se2_deg < 1e-5
    assert error.observable_mm < 1e-5
    assert error.observable_deg < 1e-5


@given(
    turn=TURNS,
    moved=st.tuples(*[st.floats(-2.0, 2.0)] * 3),
    by=st.tuples(*[st.floats(-0.3, 0.3)] * 3),
)
@settings(max_examples=25)
def test_mssd_is_that_of_a_search_by_brute_force(turn, moved, by):
    truth = pose(turn)
    mesh = rod(sides=12)
    estimate = rigid.translation(*moved) @ truth @ rigid.rotation(by)
    group = ROD_TURNS.sample_rotations(0.0005)
    apart = (
        estimate[:3, :3] @ mesh.vertices_mm.T
        + estimate[:3, 3:]
        - (truth[:3, :3] @ group @ mesh.vertices_mm.T + truth[:3, 3:])
    )
    brute_mm = np.sqrt((apart**2).sum(axis=1).max(axis=1).min())
    ours_mm = mssd_mm(estimate, truth, mesh, ROD_TURNS)
    assert ours_mm <= brute_mm + ROUNDING_MM, "the search goes between the steps"
    assert ours_mm == pytest.approx(brute_mm, abs=0.01)  # steps of 0.0005 of 30 mm


@given(turn=TURNS, axis=TURNS.filter(lambda v: np.linalg.norm(v) > 0.1), roll=st.floats(-3.1, 3.1))
def test_a_roll_about_the_axis_is_taken_back_whatever_the_axis(turn, axis, roll):
    symmetry = revolution(np.divide(axis, np.linalg.norm(axis)))
    truth = pose(turn)
    rolled = truth @ rigid.rotation(roll * symmetry.axis)
    np.testing.assert_allclose(remove_axis_rotation(rolled, truth, symmetry), rolled, atol=1e-9)


def test_a_slide_along_a_rod_counts_in_mssd_and_not_between_the_axes():
    truth = pose([0.0, 0.0, 0.4])
    error = compute_symmetric_error(
        truth @ rigid.translation(3.0, 0, 0), truth, rod(), ROD_TURNS, AT_MM
    )
    assert error.mssd_mm == pytest.approx(3.0, abs=SEARCHED_MM)
    assert error.se2_mm == pytest.approx(0.0, abs=ROUNDING_MM)
    assert math.isnan(error.observable_mm), "nothing was said about what is observable"


def test_axes_of_a_rod_are_compared_by_distance_and_angle():
    truth = pose([0.0, 0.0, 0.4])
    turned = (
        rigid.translation(*AT_MM)
        @ rigid.rotation([0, 0, math.radians(5.0)])
        @ rigid.translation(*-AT_MM)
    )
    aside = rigid.translation(*(truth[:3, 1] * 0.7))
    estimate = aside @ turned @ truth @ rigid.rotation([2.0, 0, 0])
    error = compute_symmetric_error(estimate, truth, rod(), ROD_TURNS, AT_MM)
    assert error.se2_deg == pytest.approx(5.0, abs=1e-6)
    assert error.se2_mm == pytest.approx(0.7 * math.cos(math.radians(5.0)), abs=1e-6)


def test_an_upright_peg_has_no_angle_in_the_sensor_plane():
    truth = pose([0.0, 0.0, 0.0])
    estimate = rigid.translation(0.3, 0.4, 0.0) @ truth @ rigid.rotation([0.0, 0.0, 2.2])
    error = compute_symmetric_error(estimate, truth, BOX, revolution(), AT_MM)
    assert error.se2_mm == pytest.approx(0.5)
    assert error.se2_deg == pytest.approx(0.0, abs=1e-9)


def test_half_a_turn_of_a_box_is_forgiven_only_where_its_symmetry_is_known():
    truth = pose([0.1, 0.2, 0.3])
    turned = truth @ rigid.rotation([0, 0, math.pi])
    assert mssd_mm(turned, truth, BOX, cyclic(2)) < ROUNDING_MM
    corner_mm = 2 * math.hypot(4.0, 2.0)
    assert mssd_mm(turned, truth, BOX, None) == pytest.approx(corner_mm)
    assert mssd_mm(turned, truth, BOX, asymmetric()) == pytest.approx(corner_mm)
    known = compute_symmetric_error(turned, truth, BOX, cyclic(2), AT_MM, np.eye(6))
    assert known.se2_deg == pytest.approx(0.0, abs=1e-6)
    assert known.observable_deg == pytest.approx(0.0, abs=1e-6)
    assert compute_symmetric_error(turned, truth, BOX, None, AT_MM).se2_deg > 170.0


def test_vertices_inside_the_hull_change_nothing():
    rng = np.random.default_rng(0)
    inner = rng.uniform(-0.9, 0.9, (2000, 3)) * (4.0, 2.0, 3.0) + (0.0, 0.0, 3.0)
    filled = Mesh(vertices_mm=np.concatenate([BOX.vertices_mm, inner]), triangles=BOX.triangles)
    estimate = pose([0.1, 0.2, 0.3])
    truth = pose([0.3, -0.1, 0.2], (1.4, -2.2, 20.5))
    group = cyclic(4, (1.0, 0.0, 0.0))
    assert mssd_mm(estimate, truth, filled, group) == pytest.approx(
        mssd_mm(estimate, truth, BOX, group), abs=1e-12
    )
    flat = Mesh(vertices_mm=filled.vertices_mm * (1.0, 1.0, 0.0), triangles=BOX.triangles)
    assert mssd_mm(truth, truth, flat, None) == 0.0


@given(slide=st.floats(-8.0, 8.0), roll=st.floats(-3.0, 3.0), off_mm=st.floats(-0.05, 0.05))
@settings(max_examples=40)
def test_a_hex_keys_shaft_is_a_rod_while_its_elbow_is_out_of_sight(slide, roll, off_mm):
    """The whole object has no symmetry, and still a long slide and a full roll are no observable
    error.
    """
    rng = np.random.default_rng(1)
    angle = rng.uniform(-0.8, 0.8, 800)
    normals = np.stack([np.zeros(800), np.sin(angle), -np.cos(angle)], axis=1)
    points = AT_MM + 2.0 * normals + rng.uniform(-4, 4, (800, 1)) * [1.0, 0, 0]
    at_mm = points.mean(axis=0)
    result = assess_observability(points, normals, at_mm, 0.03)
    truth = rigid.translation(*AT_MM)
    estimate_along = truth @ rigid.rotation([roll, 0, 0]) @ rigid.translation(slide, 0, 0)
    estimate = rigid.translation(0.0, 0.0, off_mm) @ estimate_along
    mm, deg = compute_observable_error(estimate_along, truth, result.observable, at_mm)
    assert mm < 1e-6
    assert deg < 1e-5
    assert mssd_mm(estimate_along, truth, rod(), None) >= abs(slide) - ROUNDING_MM
    if abs(roll) < 0.1:
        assert compute_observable_error(estimate, truth, result.observable, at_mm)[
            0
        ] == pytest.approx(abs(off_mm), abs=0.01)


@given(TURNS, st.tuples(*[st.floats(-5.0, 5.0)] * 3))
@settings(max_examples=40)
def test_with_everything_observable_the_error_is_the_whole_motion(turn, shift):
    estimate = pose(turn, shift)
    _, deg = compute_observable_error(estimate, np.eye(4), np.eye(6), np.zeros(3))
    assert deg == pytest.approx(rigid.rotation_angle_deg(estimate), abs=1e-9)
    small, _ = compute_observable_error(rigid.translation(*shift), np.eye(4), np.eye(6), AT_MM)
    assert small == pytest.approx(float(np.linalg.norm(shift)))


def test_in_plane_errors_leave_out_what_lies_along_the_optical_axis():
    truth = pose([0.0, 0.0, 0.2])
    assert compute_in_plane_error(
        rigid.translation(0.0, 0.0, 0.8) @ truth, truth, None, AT_MM
    ) == pytest.approx((0.0, 0.0))


def test_minima_that_are_the_same_pose_count_once():
    truth = pose([0.0, 0.0, 0.3])
    half = truth @ rigid.rotation([0, 0, math.pi])
    aside = rigid.translation(2.0, 0, 0) @ truth
    assert compute_ambiguity([truth, half, aside], BOX, cyclic(2), 0.1).n_distinct == 2
    result = compute_ambiguity([truth, half, aside], BOX, None, 0.1)
    assert result.n_distinct == 3
    assert result.spread_mm == pytest.approx(2 * math.hypot(4.0, 2.0), rel=0.3)
    assert compute_ambiguity([], BOX, None, 0.1).n_distinct == 0


@pytest.mark.parametrize("name", ["square", "cylinder", "peg", "hex_key"])
def test_a_recording_brings_the_symmetry_of_its_object(tmp_path, name):
    made = shapes.make_shape(name)
    with RecordingWriter(
        tmp_path / "a.h5", object_mesh=made.mesh, symmetry=made.symmetry
    ) as writer:
        writer.append("gelslim", _frame())
    recording = open_recording(tmp_path / "a.h5")
    np.testing.assert_array_equal(recording.symmetry.rotations, made.symmetry.rotations)
    assert (recording.symmetry.axis is None) == (made.symmetry.axis is None)
    recording.close()


def test_a_body_of_revolution_keeps_its_axis_and_an_older_recording_says_nothing(tmp_path):
    for name, symmetry in (("new.h5", ROD_TURNS), ("old.h5", None)):
        with RecordingWriter(tmp_path / name, object_mesh=BOX, symmetry=symmetry) as writer:
            writer.append("gelslim", _frame())
    new = open_recording(tmp_path / "new.h5")
    old = open_recording(tmp_path / "old.h5")
    np.testing.assert_array_equal(new.symmetry.axis, ROD_TURNS.axis)
    assert not new.symmetry.axis.flags.writeable
    assert old.symmetry is None
    new.close()
    old.close()


@pytest.mark.parametrize(
    "spoil", [lambda r: r * 2.0, lambda r: r[:0], lambda r: r[1:], lambda r: -r]
)
def test_turns_that_are_none_are_refused(tmp_path, spoil):
    path = tmp_path / "a.h5"
    with RecordingWriter(path, object_mesh=BOX, symmetry=cyclic(3)) as writer:
        writer.append("gelslim", _frame())
    with h5py.File(path, "r+") as file:
        group = file["object/symmetry"]
        wrong = spoil(group["rotations"][()])
        del group["rotations"]
        group.create_dataset("rotations", data=wrong).attrs["unit"] = "1"
    with pytest.raises(FileProblem, match="symmetry"):
        open_recording(path)


def test_the_simulator_writes_what_it_knows_and_claims_nothing_of_a_users_mesh():
    like = datasets.SimulationPlan(
        sensors=("gelslim",), object_source="cylinder", n_poses=1, seed=0
    )
    np.testing.assert_array_equal(
        datasets.load_object_symmetry(like).rotations,
        shapes.make_shape("cylinder").symmetry.rotations,
    )
    mesh_file = datasets.SimulationPlan(
        sensors=("gelslim",), object_source="part.stl", n_poses=1, seed=0
    )
    assert datasets.load_object_symmetry(mesh_file) is None


def test_a_simulated_recording_has_the_symmetry(tmp_path):
    plan = datasets.SimulationPlan(sensors=("gelslim",), object_source="hexagon", n_poses=1, seed=0)
    recorder.record_plan(plan, tmp_path / "a.h5")
    recording = open_recording(tmp_path / "a.h5")
    np.testing.assert_array_equal(
        recording.symmetry.rotations, datasets.load_object_symmetry(plan).rotations
    )
    recording.close()


def _frame():
    return TactileFrame(sensor="gelslim", image=np.zeros((4, 5, 3), np.uint8), reference=None)
