"""NaN, infinite, zero, negative, denormal and enormous values in each input of each stage.

The answer is masked or a typed error: never a NaN in an output that promises none, never another
exception.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from pipeline.calibration.calibration_table import make_built_in
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.meshes import Mesh
from pipeline.sensors.alignment import Alignment
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.depth.photometric import DepthParams, estimate_depth, skip_without_contact
from pipeline.stages.pose.signed_distances import PoseParams, estimate_pose
from pipeline.stages.target_depth.surface_projection import SurfaceProjectionParams, project_cloud
from pipeline.stages.touch.physical_render import PhysicalRenderParams, render_touch
from tests.stability.checks import outcome, sound
from tests.stability.rows import row
from tests.stability.scenes import (
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

POISONS = {
    "nan": np.nan,
    "inf": np.inf,
    "-inf": -np.inf,
    "zero": 0.0,
    "negative": -20.0,
    "denormal": 1e-40,
    "-denormal": -1e-40,
    "smallest": 1e-45,
    "tiny": 1e-30,
    "huge": 3e38,
    "-huge": -3e38,
    "far": 1e9,
}
ENORMOUS = ("huge", "-huge", "far", "inf", "-inf", "nan")  # of a mesh: see the other row
poisons = st.sampled_from(sorted(POISONS))
shares = st.sampled_from(["one", "some", "most", "all"])


def poisoned(array, poison, share, rng):
    """`array` as floats with this value in one, some, most or all places."""
    out = np.array(
        array, dtype=array.dtype if np.issubdtype(array.dtype, np.floating) else np.float64
    )
    where = {
        "one": np.zeros(out.shape, bool),
        "some": rng.random(out.shape) < 0.1,
        "most": rng.random(out.shape) < 0.9,
        "all": np.ones(out.shape, bool),
    }[share]
    if share == "one":
        where.flat[rng.integers(where.size)] = True
    out[where] = out.dtype.type(POISONS[poison])
    return out


@row(7, "depth: a poisoned bubble frame or reference", refused=0.15)
@given(
    st.sampled_from(["image", "reference"]),
    poisons,
    shares,
    st.sampled_from([0.0, 1.0, 5.0]),
    seeds,
)
def test_bubble_frame(field, poison, share, smoothing, seed):
    rng = np.random.default_rng(seed)
    spec = small("soft_bubble")
    clean = frame("soft_bubble", seed % 4)
    bad = replace(clean, **{field: poisoned(getattr(clean, field), poison, share, rng)})
    for stage in (estimate_depth, skip_without_contact):
        result, _ = outcome(stage, bad, spec, None, DepthParams(smoothing_px=smoothing))
        if result is not None:
            sound(result)


@row(7, "depth: a gel frame or reference of extreme greys, in bytes or in floats", refused=0.65)
@given(
    st.sampled_from(["image", "reference"]),
    poisons,
    shares,
    st.sampled_from(["digit", "gelslim"]),
    st.booleans(),
    seeds,
)
def test_gel_frame(field, poison, share, name, as_bytes, seed):
    rng = np.random.default_rng(seed)
    spec = small(name)
    clean = frame(name, seed % 4)
    bad = poisoned(getattr(clean, field), poison, share, rng)
    if as_bytes:
        bad = np.nan_to_num(np.clip(bad, 0, 255)).astype(np.uint8)
    for stage in (estimate_depth, skip_without_contact):
        result, _ = outcome(stage, replace(clean, **{field: bad}), spec, None, DepthParams())
        if result is not None:
            sound(result)
            assert np.isfinite(result.depth_mm).all(), "a gel's picture has no gaps"


@row(7, "depth: a look-up with poisoned coefficients", share=0.3, refused=0.5)
@given(poisons, shares, seeds)
def test_calibration(poison, share, seed):
    rng = np.random.default_rng(seed)
    spec = small("digit")
    clean = frame("digit", seed % 4)
    good = make_built_in(spec)
    arrays = [
        f for f in good.model.__dataclass_fields__ if isinstance(getattr(good.model, f), np.ndarray)
    ]
    field = arrays[int(rng.integers(len(arrays)))]
    bad = replace(good.model, **{field: poisoned(getattr(good.model, field), poison, share, rng)})
    result, _ = outcome(estimate_depth, clean, spec, replace(good, model=bad), DepthParams())
    if result is not None:
        sound(result)


@row(7, "adapt: poisoned depth under the contact")
@given(poisons, shares, st.sampled_from([1, 2, 5]), seeds)
def test_adapt(poison, share, stride, seed):
    rng = np.random.default_rng(seed)
    source = small("gelslim")
    target = small("soft_bubble")
    clean = depth_map(source, indentation_mm(source, "sphere", rng))
    bad = replace(clean, depth_mm=poisoned(clean.depth_mm, poison, share, rng))
    result, _ = outcome(
        back_project_depth, bad, aligned(source, target), BackProjectionParams(stride=stride)
    )
    if result is not None:
        sound(result)


@row(7, "adapt: a poisoned alignment", refused=0.65)
@given(poisons, st.integers(0, 15), st.booleans(), seeds)
def test_alignment(poison, entry, inward, seed):
    source = small("gelslim")
    target = small("soft_bubble")
    clean = depth_map(source, indentation_mm(source, "sphere", np.random.default_rng(seed)))
    way = aligned(source, target)
    sides = [way.alignment_from_source.copy(), way.target_from_alignment.copy()]
    sides[inward].flat[entry] = POISONS[poison]
    bad = Alignment(alignment_from_source=sides[0], target_from_alignment=sides[1])
    points, _ = outcome(back_project_depth, clean, bad, BackProjectionParams())
    if points is not None:
        sound(points)
        seen, _ = outcome(project_cloud, points, target, SurfaceProjectionParams())
        if seen is not None:
            sound(seen)


@row(7, "project: poisoned points")
@example("huge", "some", "surface", 48164)  # a rim drawn on beyond the largest float32
@given(poisons, shares, st.sampled_from(["surface", "paper"]), seeds)
def test_project(poison, share, mode, seed):
    rng = np.random.default_rng(seed)
    source = small("gelslim")
    target = small("soft_bubble", 0.5)
    clean = back_project_depth(
        depth_map(source, indentation_mm(source, "sphere", rng)),
        aligned(source, target),
        BackProjectionParams(),
    )
    bad = replace(clean, points_mm=poisoned(clean.points_mm, poison, share, rng))
    result, _ = outcome(project_cloud, bad, target, projection(mode))
    if result is not None:
        sound(result)


@row(7, "project: poisoned corners of what the source could see")
@given(poisons, shares, seeds)
def test_window(poison, share, seed):
    rng = np.random.default_rng(seed)
    source = small("gelslim")
    target = small("soft_bubble")
    clean = back_project_depth(
        depth_map(source, indentation_mm(source, "sphere", rng)),
        aligned(source, target),
        BackProjectionParams(),
    )
    bad = replace(clean, field_of_view_mm=poisoned(clean.field_of_view_mm, poison, share, rng))
    result, _ = outcome(project_cloud, bad, target, SurfaceProjectionParams())
    if result is not None:
        sound(result)


@row(7, "generate: a poisoned view of a bubble or a gel", share=0.1)
@given(
    st.sampled_from(["digit", "soft_bubble"]),
    st.sampled_from(["depth_mm", "indentation_mm", "both"]),
    poisons,
    shares,
    seeds,
)
def test_generate(name, field, poison, share, seed):
    rng = np.random.default_rng(seed)
    spec = small(name)
    clean = view(spec, 0.3 * indentation_mm(spec, "sphere", rng))
    fields = ("depth_mm", "indentation_mm") if field == "both" else (field,)
    bad = replace(clean, **{f: poisoned(getattr(clean, f), poison, share, rng) for f in fields})
    result, _ = outcome(render_touch, bad, spec, PhysicalRenderParams())
    if result is not None:
        sound(result)


@row(7, "pose: a poisoned touch", share=0.01)
@given(poisons, shares, seeds)
def test_pose(poison, share, seed):
    rng = np.random.default_rng(seed)
    spec = small("gelslim", 0.25)
    clean = touch(spec, indentation_mm(spec, "sphere", rng))
    bad = replace(clean, depth_mm=poisoned(clean.depth_mm, poison, share, rng))
    result, _ = outcome(estimate_pose, bad, mesh("ball"), PoseParams(face="+z", n_starts=6))
    if result is not None:
        sound(result)


@row(7, "pose: a poisoned mesh", share=0.02, refused=0.5)
@given(poisons.filter(lambda p: p not in ENORMOUS), shares, seeds)
def test_mesh(poison, share, seed):
    assert_mesh_is_sound(poison, share, seed)


@row(7, "pose: a mesh beyond any size")
def test_an_enormous_mesh():
    assert_mesh_is_sound("-huge", "most", 4_294_967_294)


def assert_mesh_is_sound(poison, share, seed):
    rng = np.random.default_rng(seed)
    spec = small("gelslim", 0.25)
    ball = mesh("ball")
    clean = touch(spec, indentation_mm(spec, "sphere", rng))
    bad = Mesh(vertices_mm=poisoned(ball.vertices_mm, poison, share, rng), triangles=ball.triangles)
    result, _ = outcome(estimate_pose, clean, bad, PoseParams(face="+z", n_starts=6))
    if result is not None:
        sound(result)


@row(7, "pose: a mesh that names vertices which it does not have", share=0.002, refused=1.0)
@given(st.sampled_from([1200, 2**31 - 1, -1201]), seeds)
def test_mesh_indices(index, seed):
    spec = small("gelslim", 0.25)
    ball = mesh("ball")
    rng = np.random.default_rng(seed)
    triangles = ball.triangles.copy()
    triangles.flat[rng.integers(triangles.size)] = index
    bad = Mesh(vertices_mm=ball.vertices_mm, triangles=triangles)
    touched = touch(spec, indentation_mm(spec, "sphere", rng))
    assert outcome(estimate_pose, touched, bad, PoseParams(face="+z", n_starts=6))[0] is None


@row(7, "camera: poisoned intrinsics, in a value and in a matrix", refused=0.3)
@given(
    st.one_of(poisons, st.sampled_from(["usual"])),
    st.sampled_from(["fx_px", "fy_px", "cx_px", "cy_px"]),
    seeds,
)
def test_camera(poison, field, seed):
    rng = np.random.default_rng(seed)
    value = POISONS.get(poison, 100.0)
    numbers = {"fx_px": 200.0, "fy_px": 210.0, "cx_px": 15.5, "cy_px": 11.5, field: value}
    camera, _ = outcome(lambda: Camera(rows=24, cols=32, **numbers))
    if camera is None:
        return
    source = small("digit")
    target = small("soft_bubble")
    there = depth_map(source, indentation_mm(source, "sphere", rng))
    rows = 24
    cols = 32
    seen = replace(
        there,
        camera=camera,
        depth_mm=np.full((rows, cols), 20.0, np.float32),
        contact=np.ones((rows, cols), bool),
    )
    points, _ = outcome(back_project_depth, seen, aligned(source, target), BackProjectionParams())
    if points is not None:
        sound(points)


@row(7, "transforms: a poisoned point goes nowhere and takes nobody with it")
@given(poisons, seeds)
def test_apply(poison, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-9, 9, (8, 3))
    bad = points.copy()
    bad[3] = POISONS[poison]
    moved = rigid.from_parts(rng.uniform(-9, 9, 3), rng.uniform(-180, 180, 3))
    with np.errstate(invalid="ignore", over="ignore"):
        a = rigid.apply(moved, points)
        b = rigid.apply(moved, bad)
    assert np.array_equal(np.delete(a, 3, 0), np.delete(b, 3, 0))
