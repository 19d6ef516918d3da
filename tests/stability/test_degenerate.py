"""Touches of no size, of all sizes, of no shape: an answer that is sound, or a sentence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from pipeline.core.geometry.meshes import Mesh
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.pose.registration.observability import assess_observability
from pipeline.stages.pose.signed_distances import PoseParams, estimate_pose
from pipeline.stages.target_depth.surface_projection import project_cloud
from pipeline.stages.touch.physical_render import PhysicalRenderParams, render_touch
from tests.stability.checks import outcome, sound
from tests.stability.rows import row
from tests.stability.scenes import (
    aligned,
    cloud,
    depth_map,
    mesh,
    projection,
    seeds,
    small,
    touch,
    view,
)

MASKS = (
    "empty",
    "one pixel",
    "corner",
    "row",
    "column",
    "two apart",
    "checkers",
    "full",
    "border",
    "half",
)
SURFACES = ("flat", "rod", "sphere", "plane", "at rest", "deepest", "beyond")
DETERMINED_IDEMPOTENT = 1e-6


def mask_of(kind, shape, rng):
    rows, cols = shape
    mask = np.zeros(shape, bool)
    r = int(rng.integers(rows))
    c = int(rng.integers(cols))
    if kind == "one pixel":
        mask[r, c] = True
    elif kind == "corner":
        mask[-(r % 2), -(c % 2)] = True
    elif kind == "row":
        mask[r] = True
    elif kind == "column":
        mask[:, c] = True
    elif kind == "two apart":
        mask[r, c] = mask[rows - 1 - r, cols - 1 - c] = True
    elif kind == "checkers":
        mask[(np.arange(rows)[:, None] + np.arange(cols)[None, :]) % 2 == 0] = True
    elif kind == "full":
        mask[:] = True
    elif kind == "border":
        mask[[0, -1]] = mask[:, [0, -1]] = True
    elif kind == "half":
        mask[:, : cols // 2] = True
    return mask


def pushed_mm(kind, spec, rng):
    rows, cols = spec.camera.shape
    x = np.linspace(-1, 1, cols)[None, :]
    y = np.linspace(-1, 1, rows)[:, None]
    most = spec.limits.indentation_max_mm
    shape = {
        "flat": 0.5 * most + 0 * x * y,
        "rod": 0.5 * most * np.sqrt(np.maximum(1 - x**2, 0.01)) + 0 * y,
        "sphere": 0.5 * most * np.sqrt(np.maximum(1 - x**2 - y**2, 0.01)),
        "plane": 0.4 * most * (1 + 0.5 * x + 0 * y),
        "at rest": 0 * x * y,
        "deepest": most + 0 * x * y,
        "beyond": 3 * most + 0 * x * y,
    }[kind]
    return shape * rng.uniform(0.5, 1.0)


@row(8, "adapt and project: any mask over any surface, either way of drawing")
@given(
    st.sampled_from(MASKS),
    st.sampled_from(SURFACES),
    st.sampled_from(["surface", "paper"]),
    st.sampled_from([1, 3, 16]),
    seeds,
)
def test_adapt_and_project(mask, surface, mode, stride, seed):
    rng = np.random.default_rng(seed)
    source = small("gelslim")
    target = small("soft_bubble", 0.5)
    touched = mask_of(mask, source.camera.shape, rng)
    depth = replace(depth_map(source, pushed_mm(surface, source, rng)), contact=touched)
    points = back_project_depth(depth, aligned(source, target), BackProjectionParams(stride=stride))
    sound(points)
    assert len(points.points_mm) == touched[::stride, ::stride].sum()
    seen = project_cloud(points, target, projection(mode))
    sound(seen)
    # The gel's window lies inside the bubble's view: what touches the one is seen by the other.
    assert (seen.source_index >= 0).any() == bool(len(points.points_mm))


@row(8, "project: from none to a few points, at one place, in one line, in one plane")
@given(
    st.integers(0, 5),
    st.sampled_from(["coincident", "line", "plane", "behind", "outside", "at the lens"]),
    st.sampled_from(["surface", "paper"]),
    seeds,
)
@example(0, "line", "surface", 0)
def test_few_points(n, place, mode, seed):
    rng = np.random.default_rng(seed)
    target = small("digit")
    z = float(target.rest_depth_mm.min()) - 0.3
    points = np.column_stack([rng.uniform(-2, 2, (n, 2)), np.full(n, z)])
    if place == "coincident":
        points[:] = points[:1] if n else points
    elif place == "line":
        points[:, 1] = points[:, 0]
    elif place == "behind":
        points[:, 2] *= -1
    elif place == "outside":
        points[:, 0] += 1e4
    elif place == "at the lens":
        points[:, 2] = 0.0
    spread = replace(
        cloud(points), source_index=np.sort(rng.permutation(2500)[:n]).astype(np.int32)
    )
    result = project_cloud(spread, target, projection(mode))
    sound(result)
    assert result.contact.any() == (n > 0 and place in ("coincident", "line", "plane"))


@row(8, "generate: any mask over any surface, on a gel and on a bubble", share=0.05)
@given(
    st.sampled_from(["digit", "soft_bubble"]),
    st.sampled_from(MASKS),
    st.sampled_from(SURFACES),
    seeds,
)
def test_generate(name, mask, surface, seed):
    rng = np.random.default_rng(seed)
    spec = small(name)
    touched = mask_of(mask, spec.camera.shape, rng)
    seen = replace(
        view(spec, np.where(touched, pushed_mm(surface, spec, rng), 0.0)), contact=touched
    )
    seen = replace(
        seen,
        depth_mm=np.where(touched, spec.rest_depth_mm - seen.indentation_mm, np.nan).astype(
            np.float32
        ),
    )
    result, message = outcome(render_touch, seen, spec, PhysicalRenderParams())
    assert result is not None, message
    sound(result)
    if not touched.any():
        assert not result.membrane.indentation_mm.any()


@row(8, "pose: any mask over any surface", share=0.005)
@given(st.sampled_from(MASKS), st.sampled_from(SURFACES), seeds)
def test_pose(mask, surface, seed):
    rng = np.random.default_rng(seed)
    spec = small("gelslim", 0.25)
    touched = replace(
        touch(spec, pushed_mm(surface, spec, rng)), contact=mask_of(mask, spec.camera.shape, rng)
    )
    result, message = outcome(estimate_pose, touched, mesh("ball"), PoseParams(n_starts=6))
    assert result is not None, message
    sound(result)


@row(
    8,
    "pose: a mesh of nothing, of one triangle, of coincident points, without volume",
    share=0.02,
    refused=0.8,
)
@given(
    st.sampled_from(
        [
            "no triangle",
            "no vertex",
            "one",
            "coincident",
            "line",
            "sheet",
            "two copies",
            "speck",
            "continent",
        ]
    ),
    seeds,
)
def test_mesh(kind, seed):
    rng = np.random.default_rng(seed)
    spec = small("gelslim", 0.25)
    ball = mesh("ball")
    corners = rng.uniform(-5, 5, (3, 3))
    first = np.array([[0, 1, 2]], np.int32)
    vertices, triangles = {
        "no triangle": (corners, np.empty((0, 3), np.int32)),
        "no vertex": (np.empty((0, 3)), np.empty((0, 3), np.int32)),
        "one": (corners, first),
        "coincident": (np.repeat(corners[:1], 3, axis=0), first),
        "line": (np.outer([0.0, 1.0, 2.0], corners[0]), first),
        "sheet": (
            np.array([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0.0]]),
            np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        ),
        "two copies": (
            np.concatenate([ball.vertices_mm] * 2),
            np.concatenate([ball.triangles, ball.triangles + len(ball.vertices_mm)]),
        ),
        "speck": (ball.vertices_mm * 1e-9, ball.triangles),
        "continent": (ball.vertices_mm * 1e9, ball.triangles),
    }[kind]
    touched = touch(
        spec, np.where(mask_of("half", spec.camera.shape, rng), pushed_mm("sphere", spec, rng), 0.0)
    )
    bad = Mesh(vertices_mm=vertices, triangles=triangles.astype(np.int32), name=kind)
    result, _ = outcome(estimate_pose, touched, bad, PoseParams(face="+z", n_starts=6))
    if result is not None:
        sound(result)


@row(
    8,
    "what few, coincident or collinear matched points determine: finite, idempotent, never all six",
)
@given(st.integers(1, 5), st.sampled_from(["coincident", "line", "plane", "far"]), seeds)
def test_observability(n, place, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-5, 5, (n, 3))
    normals = rng.standard_normal((n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    if place == "coincident":
        points[:] = points[0]
    elif place == "line":
        points[:, 1:] = 0
    elif place == "plane":
        points[:, 2] = 0.0
        normals[:] = (0.0, 0.0, 1.0)
    elif place == "far":
        points += 1e6
    result = assess_observability(points, normals, points.mean(axis=0), 0.01)
    assert np.isfinite(result.covariance).all()
    assert np.isfinite(result.observable).all()
    scale = max(1.0, float(np.abs(result.observable).max())) ** 2
    assert (
        np.abs(result.observable @ result.observable - result.observable).max()
        <= DETERMINED_IDEMPOTENT * scale
    )
    assert (
        len(result.weak_directions)
        == len(result.weak_motions)
        == 6 - round(float(np.trace(result.observable)))
    )
    assert len(result.weak_directions) >= max(1, 6 - n)
