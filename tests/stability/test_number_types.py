"""float64, float32 and float16 in: the same answer but for the rounding of what came in, always
float32 out.

float16 is widened where a frame or a depth is read; no stage computes in it. Whole numbers count as
numbers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pipeline.core.geometry import rigid
from pipeline.core.values.frames import TactileFrame
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.depth.photometric import DepthParams, estimate_depth, skip_without_contact
from pipeline.stages.pose.signed_distances import PoseParams, estimate_pose
from pipeline.stages.target_depth.surface_projection import SurfaceProjectionParams, project_cloud
from pipeline.stages.touch.physical_render import PhysicalRenderParams, render_touch
from tests.stability.checks import outcome, sound
from tests.stability.rows import row
from tests.stability.scenes import (
    KINDS,
    aligned,
    depth_map,
    frame,
    indentation_mm,
    mesh,
    projection,
    seeds,
    small,
    touch,
    view,
)

FLOATS = st.sampled_from([np.float64, np.float32, np.float16])
WIDE = st.sampled_from([np.float64, np.float32])
ANY = st.sampled_from(
    [np.float64, np.float32, np.float16, np.int32, np.int64, np.uint8, np.bool_, np.complex128]
)


def ulp_mm(kind, largest_mm):
    return float(np.finfo(kind).eps) * largest_mm


@row(6, "a bubble's frame of any float type: float32 out, off by no more than its ulp")
@given(FLOATS, FLOATS, st.integers(0, 3))
def test_bubble_frame(kind, still_kind, seed):
    spec = small("soft_bubble")
    seen = frame("soft_bubble", seed)
    other = replace(
        seen, image=seen.image.astype(kind), reference=seen.reference.astype(still_kind)
    )
    a, b = (estimate_depth(f, spec, None, DepthParams()) for f in (seen, other))
    sound(b)
    far_mm = float(np.nanmax(seen.image))
    off_mm = np.abs(a.indentation_mm - b.indentation_mm)
    # The frame and its reference are rounded, then smoothed; a reading at a limit may go either
    # way.
    assert (
        np.nanquantile(off_mm, 0.99)
        <= 2 * (ulp_mm(kind, far_mm) + ulp_mm(still_kind, far_mm)) + 1e-4
    )
    early = skip_without_contact(other, spec, None, DepthParams())
    assert early is None


@row(6, "a frame of any other type of number: an answer or words", refused=0.75)
@given(st.sampled_from(["digit", "soft_bubble"]), ANY, ANY, st.integers(0, 3))
def test_any_frame(name, kind, still_kind, seed):
    spec = small(name)
    seen = frame(name, seed)
    with np.errstate(invalid="ignore"):
        still = np.nan_to_num(seen.reference).astype(still_kind)
        image = np.nan_to_num(seen.image).astype(kind)
    other = TactileFrame(sensor=name, image=image, reference=still)
    for stage in (estimate_depth, skip_without_contact):
        result, _ = outcome(stage, other, spec, None, DepthParams())
        if result is not None:
            sound(result)


@row(6, "depth of float64 and float32: the same cloud but for the ulp, float32 out")
@given(st.sampled_from(KINDS), WIDE, seeds)
def test_adapt(kind, number, seed):
    source = small("gelslim")
    target = small("soft_bubble")
    pushed_mm = indentation_mm(source, kind, np.random.default_rng(seed))
    # digits that float32 cannot hold
    exact_mm = source.rest_depth_mm.astype(np.float64) - pushed_mm
    exact = replace(depth_map(source, pushed_mm), depth_mm=exact_mm)
    rounded = replace(exact, depth_mm=exact_mm.astype(number))
    a, b = (
        back_project_depth(d, aligned(source, target), BackProjectionParams())
        for d in (exact, rounded)
    )
    sound(b)
    assert len(a.points_mm) == np.count_nonzero(exact.contact) > 0
    assert np.array_equal(a.source_index, b.source_index)
    # A ray is longer than its z by less than half; each side is rounded to float32 once more on its
    # way out.
    far_mm = float(exact_mm.max())
    assert np.abs(a.points_mm - b.points_mm).max() <= 1.5 * ulp_mm(number, far_mm) + 2 * ulp_mm(
        np.float32, far_mm
    )


@row(6, "points of float64 and float32: the same view but for the ulp")
@given(st.sampled_from(KINDS), WIDE, st.sampled_from(["surface", "paper"]), seeds)
def test_project(kind, number, mode, seed):
    rng = np.random.default_rng(seed)
    source = small("gelslim")
    target = small("soft_bubble", 0.5)
    points = back_project_depth(
        depth_map(source, indentation_mm(source, kind, rng)),
        aligned(source, target),
        BackProjectionParams(),
    )
    # less than float32 holds
    exact_mm = points.points_mm * (1.0 + rng.uniform(-1e-7, 1e-7, points.points_mm.shape))
    a = project_cloud(replace(points, points_mm=exact_mm), target, projection(mode))
    b = project_cloud(replace(points, points_mm=exact_mm.astype(number)), target, projection(mode))
    sound(b)
    n_seen = np.count_nonzero(a.source_index >= 0)
    # of points at one distance either may be named
    both = (a.source_index >= 0) & (b.source_index >= 0)
    assert n_seen > 0
    assert both.sum() >= 0.98 * n_seen - 2
    assert np.quantile(np.abs(a.depth_mm - b.depth_mm)[both], 0.9) <= 4 * ulp_mm(
        number, 60.0
    ) + ulp_mm(np.float32, 60.0)


@pytest.mark.parametrize("stage", ["adapt", "project"])
@row(6, "adapt and project of float16: an answer or words")
def test_half_precision(stage):
    source = small("gelslim")
    target = small("soft_bubble", 0.5)
    seen = depth_map(source, indentation_mm(source, "sphere", np.random.default_rng(1)))
    points = back_project_depth(seen, aligned(source, target), BackProjectionParams())
    if stage == "adapt":
        half = replace(seen, depth_mm=seen.depth_mm.astype(np.float16))
        result, _ = outcome(
            back_project_depth, half, aligned(source, target), BackProjectionParams()
        )
    else:
        half = replace(points, points_mm=points.points_mm.astype(np.float16))
        result, _ = outcome(project_cloud, half, target, SurfaceProjectionParams())
    if result is not None:
        sound(result)


@row(6, "a view of any float type: the same touch but for the ulp", share=0.1)
@given(st.sampled_from(["digit", "soft_bubble"]), st.sampled_from(KINDS), FLOATS, seeds)
# a node that the rounding lifts onto a ledge of 5 mm
@example("soft_bubble", "ripple", np.float16, 2382443)
def test_generate(name, kind, number, seed):
    spec = small(name)
    seen = view(spec, 0.3 * indentation_mm(spec, kind, np.random.default_rng(seed)))
    other = replace(
        seen,
        depth_mm=seen.depth_mm.astype(number),
        indentation_mm=seen.indentation_mm.astype(number),
    )
    a, b = (render_touch(v, spec, PhysicalRenderParams()) for v in (seen, other))
    sound(b)
    made = a.membrane.indentation_mm
    other = b.membrane.indentation_mm
    assert other.dtype == np.float32
    off_mm = np.abs(made - other)
    tolerance_mm = 4 * ulp_mm(number, float(spec.rest_depth_mm.max())) + 2e-3
    # At a ledge a node of the lattice lies on one of its sides or the other: hardly any, and none
    # beyond the ledge.
    assert np.count_nonzero(off_mm > tolerance_mm) <= 1 + np.count_nonzero(seen.contact) // 50
    assert off_mm.max() <= seen.indentation_mm.max() + tolerance_mm


@row(6, "a mesh and a membrane of any float type: the same pose, or words", share=0.01)
@given(FLOATS, FLOATS, st.sampled_from([np.int32, np.int64, np.uint32]), seeds)
def test_pose(number, of_mesh, of_index, seed):
    spec = small("gelslim", 0.25)
    touched = touch(spec, indentation_mm(spec, "sphere", np.random.default_rng(seed)))
    other = replace(touched, depth_mm=touched.depth_mm.astype(number))
    ball = mesh("ball")
    ball = replace(
        ball,
        vertices_mm=ball.vertices_mm.astype(of_mesh),
        triangles=ball.triangles.astype(of_index),
    )
    result, message = outcome(estimate_pose, other, ball, PoseParams(face="+z", n_starts=6))
    assert result is not None or np.float16 in (number, of_mesh), message
    if result is not None:
        sound(result)


@row(6, "a transform of any float type: orthonormal in float64, or words", refused=0.5)
@given(st.sampled_from([np.float64, np.float32, np.float16]), seeds)
def test_transform(number, seed):
    rng = np.random.default_rng(seed)
    moved = rigid.from_parts(rng.uniform(-30, 30, 3), rng.uniform(-180, 180, 3))
    answer, message = outcome(rigid.validate_rigid, moved.astype(number), "it")
    if answer is None:
        assert number is np.float16, message
        return
    assert answer.dtype == np.float64
    # Exponential, singular value decomposition and product of three columns each round a few times:
    # 16 in all.
    assert np.abs(answer[:3, :3] - moved[:3, :3]).max() <= 16 * np.finfo(number).eps
