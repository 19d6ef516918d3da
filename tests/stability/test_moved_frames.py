"""Both sensors carried anywhere, by up to a kilometre: nothing changes but what float64 must round.

The rounding model. T_S->T is composed in float64 from T_S->A and T_A->T. Carried by a motion G,
both hold shifts of size t, and their product is off by a sum of four products of entries at most 1
and t, each rounded by half an ulp:
|dT| <= 8 eps64 (1 + t). A rotation that is orthonormal to an ulp adds as much again. Points leave rounded to float32:
|dP| <= 16 eps64 (1 + t + |P|) + eps32 |P|. At t = 1e6 mm that is 4e-9 mm and the last bit of a float32.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.geometry import rigid
from pipeline.core.geometry.membrane import Membrane
from pipeline.core.geometry.meshes import Mesh
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors.alignment import Alignment
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.pose.registration.observability import assess_observability
from pipeline.stages.pose.signed_distances import PoseParams, estimate_pose
from pipeline.stages.target_depth.surface_projection import project_cloud
from tests.pipeline.stages.pose.registration.solids import REST_MM, notched_wedge, observe_depth
from tests.stability.rows import row
from tests.stability.scenes import (
    KINDS,
    aligned,
    depth_map,
    indentation_mm,
    mesh,
    projection,
    rigid_motions,
    seeds,
    small,
)

EPS64 = np.finfo(np.float64).eps
EPS32 = np.finfo(np.float32).eps
POSE_MM = 0.02  # a fifth of the camera's pixel
powers = st.integers(0, 6)


def carried(alignment: Alignment, by) -> Alignment:
    return Alignment(
        alignment_from_source=by @ alignment.alignment_from_source,
        target_from_alignment=alignment.target_from_alignment @ rigid.invert(by),
    )


def rounding_mm(points, shift_mm):
    size = float(np.abs(points).max(initial=0.0))
    return 16 * EPS64 * (1 + shift_mm + size) + EPS32 * size


@row("2,5", "the alignment frame carried by up to 1e6 mm: points move by the rounding model only")
@given(st.sampled_from(KINDS), rigid_motions(1.0), powers, seeds)
def test_cloud_under_a_carried_alignment_frame(kind, motion, power, seed):
    source = small("gelslim")
    target = small("soft_bubble")
    depth = depth_map(source, indentation_mm(source, kind, np.random.default_rng(seed)))
    motion[:3, 3] *= 10.0**power
    here, there = (
        back_project_depth(depth, a, BackProjectionParams())
        for a in (aligned(source, target), carried(aligned(source, target), motion))
    )
    assert np.array_equal(here.source_index, there.source_index)
    gap_mm = np.abs(here.points_mm.astype(np.float64) - there.points_mm).max(initial=0.0)
    assert gap_mm <= rounding_mm(here.points_mm, 2 * 10.0**power)


@row(
    "2,5",
    "the alignment frame carried by up to 1e6 mm: the target's view stays, depth within the model",
)
@given(
    st.sampled_from(KINDS), st.sampled_from(["surface", "paper"]), rigid_motions(1.0), powers, seeds
)
def test_view_under_a_carried_alignment_frame(kind, mode, motion, power, seed):
    source = small("gelslim")
    target = small("soft_bubble", 0.5)
    depth = depth_map(source, indentation_mm(source, kind, np.random.default_rng(seed)))
    motion[:3, 3] *= 10.0**power
    a, b = (
        project_cloud(
            back_project_depth(depth, way, BackProjectionParams()), target, projection(mode)
        )
        for way in (aligned(source, target), carried(aligned(source, target), motion))
    )
    seen_a = a.source_index >= 0
    seen_b = b.source_index >= 0
    same = seen_a & seen_b & (a.source_index == b.source_index)
    # A point in the last bit at a border falls on either side of it.
    assert (seen_a ^ seen_b).sum() <= 0.01 * seen_a.sum() + 2
    gap_mm = np.abs(a.depth_mm.astype(np.float64) - b.depth_mm)[same]
    assert (
        np.quantile(gap_mm, 0.99, method="lower")
        <= 64 * rounding_mm(a.depth_mm[same], 2 * 10.0**power)
        if same.any()
        else True
    )


@row(
    "2,5",
    "points and transform moved together: x and R x + t differ by a rotation, lengths kept to "
    "float64",
)
@given(rigid_motions(1.0), rigid_motions(1.0), powers, seeds)
def test_apply_is_a_group_action(a, b, power, seed):
    a[:3, 3] *= 10.0**power
    points = np.random.default_rng(seed).uniform(-50, 50, (64, 3))
    together = rigid.apply(a @ b, points)
    in_turn = rigid.apply(a, rigid.apply(b, points))
    assert np.abs(together - in_turn).max() <= 32 * EPS64 * (100 + 2 * 10.0**power)
    lengths = np.linalg.norm(np.diff(rigid.apply(a, points), axis=0), axis=1)
    gap = np.abs(lengths - np.linalg.norm(np.diff(points, axis=0), axis=1)).max()
    assert gap <= 16 * EPS64 * (100 + 2 * 10.0**power)


@row("2,5", "a membrane and its points carried sideways by up to 1e6 mm: the same signed distance")
@given(powers, seeds)
def test_signed_distance_under_a_shift(power, seed):
    rng = np.random.default_rng(seed)
    m = small("soft_bubble").membrane
    by = rng.uniform(-1, 1, 3) * 10.0**power
    there = Membrane(
        x0_mm=m.x0_mm + by[0], y0_mm=m.y0_mm + by[1], step_mm=m.step_mm, z_mm=m.z_mm + by[2]
    )
    points = rng.uniform(-40, 40, (64, 3))
    points[:, 2] += m.z_mm.mean()
    gap = np.abs(m.signed_distance_mm(points) - there.signed_distance_mm(points + by)).max()
    assert gap <= 64 * EPS64 * (100 + 2 * 10.0**power)


@row("2,5", "matched points carried together by up to 1e6 mm: the same motions are observable")
@given(rigid_motions(1.0), powers, seeds)
def test_observability_under_a_motion(motion, power, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-5, 5, (200, 3)) * (1, 1, 0.1)
    normals = rng.standard_normal((200, 3)) * (*rng.choice([0.0, 1.0], 2), 1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    motion[:3, 3] *= 10.0**power
    here = assess_observability(points, normals, points.mean(axis=0), 0.03)
    there_points = rigid.apply(motion, points)
    there = assess_observability(
        there_points, normals @ motion[:3, :3].T, there_points.mean(axis=0), 0.03
    )
    assert len(here.weak_directions) == len(there.weak_directions)
    turn = np.kron(np.eye(2), motion[:3, :3])
    limit = 1e-9 + 1e4 * EPS64 * 10.0**power
    assert np.abs(turn @ here.observable @ turn.T - there.observable).max() <= limit * 10
    assert (
        np.abs(turn @ here.covariance @ turn.T - there.covariance).max()
        <= limit * np.abs(here.covariance).max()
    )


@row("2,5", "object and sensor carried together by up to 1e6 mm: the same reading", share=0.05)
@given(st.sampled_from(["digit", "soft_bubble"]), rigid_motions(1.0), powers)
def test_press_under_a_motion(name, motion, power):
    spec = small(name)
    ball = mesh("ball")
    pose_of = rigid.translation(0.5, -0.3, 7.6 if name == "digit" else 2.0)
    motion[:3, 3] *= 10.0**power
    there = replace(spec, alignment_from_sensor=motion @ spec.alignment_from_sensor)
    a = simulate_press(ball, pose_of, spec, seed=None)
    b = simulate_press(ball, motion @ pose_of, there, seed=None)
    # The solve stops at a tenth of a micrometre, and a grey level or a depth reading is a rounded
    # number.
    gap_mm = np.abs(a.truth.indentation_mm - b.truth.indentation_mm).max()
    assert gap_mm <= 2e-4 + 1e3 * EPS64 * 10.0**power
    assert (a.truth.contact ^ b.truth.contact).sum() <= 2


@row(
    "2,5",
    "the mesh's own origin moved by up to 10 mm: the object is found in the same place",
    share=0.01,
)
@given(st.integers(0, 1), seeds)
def test_pose_under_another_origin(power, seed):
    assert_found_from_another_origin(power, seed)


@pytest.mark.parametrize("power", [4, 6])
@row("2,5", "the mesh's own origin moved by 1e4 and 1e6 mm: the object is found in the same place")
def test_pose_under_a_far_origin(power):
    assert_found_from_another_origin(power, seed=2)


def assert_found_from_another_origin(power, seed):
    rng = np.random.default_rng(seed)
    thing = notched_wedge().mesh
    truth = rigid.translation(0.3, -0.2, REST_MM + 1.2) @ rigid.rotation([0, 0, rng.uniform(-3, 3)])
    touched = observe_depth(notched_wedge(), truth @ rigid.rotation([np.pi, 0, 0]))
    shift = rng.uniform(-1, 1, 3) * 10.0**power
    moved = Mesh(vertices_mm=thing.vertices_mm + shift, triangles=thing.triangles, name=thing.name)
    a, b = (estimate_pose(touched, m, PoseParams(face="+z", n_starts=12)) for m in (thing, moved))
    if a.sensor_from_object is None or b.sensor_from_object is None:
        pytest.fail(f"no pose: {a.notes} {b.notes}")
    middle_mm = rigid.apply(a.sensor_from_object, np.zeros(3)) - rigid.apply(
        b.sensor_from_object, shift
    )
    assert np.linalg.norm(middle_mm) <= POSE_MM
    assert abs(a.rmse_mm - b.rmse_mm) <= POSE_MM
    assert a.weak_directions == b.weak_directions
