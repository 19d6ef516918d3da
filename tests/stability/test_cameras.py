"""Any focal length from 1 to 1e5 px, any angle, any distance, and a target that looks the other
way.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from pipeline.core.geometry import membrane, rigid
from pipeline.core.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import load_sensor
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.target_depth.surface_projection import project_cloud
from tests.stability.checks import sound
from tests.stability.rows import row
from tests.stability.scenes import depth_map, projection, rigid_motions, seeds, unit_numbers

EPS64 = np.finfo(np.float64).eps
EPS32 = np.finfo(np.float32).eps
ROWS = 24
COLS = 32
MODES = st.sampled_from(["surface", "paper"])
HERE = Alignment(alignment_from_source=np.eye(4), target_from_alignment=np.eye(4))

focals_px = st.one_of(st.floats(0, 5).map(lambda e: 10**e), st.sampled_from([1.0, 1e5]))
distances_mm = st.one_of(
    st.floats(-6, 6).map(lambda e: 10**e), st.sampled_from([1e-6, 1e-3, 1.0, 1e6])
)


def camera_of(fx_px, fy_px=None, cx_px=(COLS - 1) / 2, cy_px=(ROWS - 1) / 2):
    return Camera(
        rows=ROWS,
        cols=COLS,
        fx_px=fx_px,
        fy_px=fx_px if fy_px is None else fy_px,
        cx_px=cx_px,
        cy_px=cy_px,
    )


def level_sensor(camera, z_mm):
    """A sensor with a level membrane at this distance, wide enough for its view."""
    half = 2 * z_mm * (COLS / camera.fx_px + ROWS / camera.fy_px) + 1e-9
    pad = membrane.make_flat_membrane(z_mm, half, half)
    return replace(
        load_sensor("gelslim"),
        camera=camera,
        membrane=pad,
        rest_depth_mm=np.full(camera.shape, float(z_mm)),
    )


def plane_depth(camera, z_mm):
    spec = level_sensor(camera, z_mm)
    flat = depth_map(spec, np.zeros(camera.shape))
    return replace(flat, contact=np.ones(camera.shape, bool))


@row(
    9,
    "through one camera and back into it, focal lengths 1 to 1e5 px, 1e-6 to 1e6 mm: pixel for "
    "pixel",
)
@given(focals_px, focals_px, distances_mm, MODES)
@example(1.0, 1.0, 1e6, "surface")
@example(1e5, 1e5, 1e-3, "surface")
@example(1.0, 1e5, 1.0, "paper")
def test_same_camera(fx, fy, z_mm, mode):
    camera = camera_of(fx, fy)
    points = back_project_depth(plane_depth(camera, z_mm), HERE, BackProjectionParams())
    sound(points)
    if float(np.float32(z_mm)) <= MIN_DEPTH_MM:
        assert len(points.points_mm) == 0, (
            "nearer than a micrometre to the lens nothing has an image"
        )
        return
    target = level_sensor(camera, 2 * z_mm)
    # At one pixel of focal length the picture's edge is seen at 86 degrees, and neighbours lie far
    # apart.
    seen = project_cloud(
        points, target, projection(mode, grazing_deg=90.0, jump_mm=1e9 * (1 + z_mm))
    )
    sound(seen)
    # float32 moves a corner of the grid by its last bit, so that the outermost pixel centres may
    # lie off the surface.
    inner = seen.contact if mode == "paper" else seen.contact[1:-1, 1:-1]
    assert inner.all()
    assert seen.contact.mean() > 0.85
    assert np.abs(seen.depth_mm[seen.contact] / np.float32(z_mm) - 1).max() <= 4 * EPS32


@row(
    9,
    "a target anywhere, turned any way, behind the touch as well: sound, and nothing seen from "
    "behind",
)
@given(rigid_motions(60.0), focals_px, MODES, seeds)
def test_target_anywhere(motion, fx, mode, seed):
    camera = camera_of(60.0)
    depth = plane_depth(camera, 20.0)
    way = Alignment(alignment_from_source=motion, target_from_alignment=np.eye(4))
    points = back_project_depth(depth, way, BackProjectionParams())
    sound(points)
    seen = project_cloud(points, level_sensor(camera_of(fx), 200.0), projection(mode))
    sound(seen)
    if (points.points_mm[:, 2] <= MIN_DEPTH_MM).all():
        assert not (seen.source_index >= 0).any()
        assert seen.notes


@row(9, "a plane seen at 0 to 89.9 degrees: what is drawn lies on it, up to the limit of grazing")
@given(st.floats(0.0, 89.9), unit_numbers, MODES, st.sampled_from([60.0, 84.0, 89.95]))
@example(89.9, 0.3, "surface", 89.95)
@example(0.0, 0.0, "surface", 84.0)
def test_grazing(angle_deg, around, mode, limit_deg):
    camera = camera_of(60.0)
    axis = np.array([np.cos(np.pi * around), np.sin(np.pi * around), 0.0])
    turn = (
        rigid.translation(0, 0, 20.0)
        @ rigid.rotation(axis * np.deg2rad(angle_deg))
        @ rigid.translation(0, 0, -20.0)
    )
    way = Alignment(alignment_from_source=turn, target_from_alignment=np.eye(4))
    points = back_project_depth(plane_depth(camera, 20.0), way, BackProjectionParams())
    seen = project_cloud(
        points, level_sensor(camera, 200.0), projection(mode, grazing_deg=limit_deg, jump_mm=1e6)
    )
    sound(seen)
    z = seen.depth_mm.astype(np.float64)
    on = seen.source_index >= 0
    if angle_deg < 30:
        assert on.mean() > 0.5
    if mode == "surface" and on.any():
        x, y = camera.rays()
        p = np.stack([z * x[None, :], z * y[:, None], z], axis=-1)[on]
        normal = turn[:3, 2]
        off_mm = np.abs((p - (0, 0, 20.0)) @ normal)
        if any("drawn as points" in note for note in seen.notes):
            return  # narrower than a pixel: each point stands for the whole of its pixel
        # Along a ray that meets the plane at a flat angle a float32 of z is a longer way off than
        # across it.
        assert off_mm.max() <= 64 * EPS32 * np.abs(p).max() + 1e-6


@row(9, "a membrane at any distance through any camera: its rest depth lies on it, or words")
@given(focals_px, distances_mm, st.booleans())
def test_rest_depth(fx, z_mm, domed):
    camera = camera_of(fx)
    half = 2 * z_mm * (COLS + ROWS) / fx + 1e-9
    surface = membrane.make_flat_membrane(z_mm, half, half)
    if domed:
        surface = membrane.make_dome_membrane(
            z_mm, 0.2 * min(z_mm, half), half, half, step_mm=half / 20
        )
    rest = surface.rest_depth_mm(camera)
    assert np.isfinite(rest).all()
    assert (rest > 0).all()
    x, y = camera.rays()
    off = surface.depth_at(x[None, :] * rest, y[:, None] * rest) - rest
    assert np.abs(off).max() <= 1e-6 + 1e-9 * z_mm
