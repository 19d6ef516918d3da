"""A touch carried to the target and back is where it was, wherever both saw it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.geometry import membrane, rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.values.results import DepthMap
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import load_sensor
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.metrics.stage_metrics import iou
from pipeline.stages.target_depth.surface_projection import SurfaceProjectionParams, project_cloud
from tests.stability.rows import row
from tests.stability.scenes import depth_map, rigid_motions, seeds

BACK_MM = 2e-4  # two chords of one pixel on a 10 mm radius, d^2 / 8 R each; and float32 at 50 mm
MASK_IOU = 0.98  # the outline may lose a row of pixels on the way
# Half a millimetre of float32 noise on the ray's side: the outline's own triangles reach beyond
# what was seen.
CAMERA = Camera(rows=220, cols=260, fx_px=1300.0, fy_px=1300.0, cx_px=129.5, cy_px=109.5)
REST_MM = 45.0
RADIUS_MM = 12.0


def at(camera: Camera, rest_mm: float):
    """A sensor whose membrane lies behind everything: every point seen is a point that it feels."""
    pad = membrane.make_flat_membrane(rest_mm, 40.0, 40.0)
    return replace(
        load_sensor("gelslim"), camera=camera, membrane=pad, rest_depth_mm=pad.rest_depth_mm(camera)
    )


def smooth(camera: Camera, kind: str, rng: np.random.Generator) -> np.ndarray:
    """Indentation (rows, cols) of a smooth thing within a disc in the middle."""
    ray_x, ray_y = camera.rays()
    x = ray_x[None, :] * REST_MM
    y = ray_y[:, None] * REST_MM
    angle = rng.uniform(0, np.pi)
    r_sq = x * x + y * y
    across = np.cos(angle) * x + np.sin(angle) * y
    height = {
        "ball": 1.5 - r_sq / (2 * RADIUS_MM),
        "rod": 1.5 - across**2 / (2 * RADIUS_MM) + 0 * r_sq,
        "plane": 1.0 + 0.25 * across,
        "saddle": 1.0 + (across**2 - r_sq / 2) / (2 * RADIUS_MM),
    }[kind]
    return np.where(r_sq < 3.4**2, np.maximum(height, 1e-3), 0.0)


@row(1, "to the target and back: depth within 2e-4 mm, mask IoU at least 0.98", share=0.2)
@given(
    st.sampled_from(["ball", "rod", "plane", "saddle"]), rigid_motions(1.0, np.deg2rad(15)), seeds
)
def test_there_and_back(kind, motion, seed):
    source = at(CAMERA, REST_MM)
    depth = depth_map(source, smooth(CAMERA, kind, np.random.default_rng(seed)))
    about = rigid.translation(0, 0, REST_MM) @ motion @ rigid.translation(0, 0, -REST_MM)
    there = Alignment(alignment_from_source=about, target_from_alignment=np.eye(4))
    back = Alignment(alignment_from_source=np.eye(4), target_from_alignment=rigid.invert(about))
    behind = at(CAMERA, 70.0)
    finer = SurfaceProjectionParams(grazing_deg=89.0)
    view = project_cloud(back_project_depth(depth, there, BackProjectionParams()), behind, finer)
    seen = DepthMap(
        indentation_mm=view.indentation_mm,
        depth_mm=view.depth_mm,
        contact=view.contact,
        camera=view.camera,
        source_index=view.source_index,
    )
    again = project_cloud(back_project_depth(seen, back, BackProjectionParams()), behind, finer)
    both = again.contact & depth.contact
    off_mm = np.abs(again.depth_mm - depth.depth_mm)[both]
    assert both.sum() > 10_000
    assert np.isfinite(off_mm).all()
    assert off_mm.max() <= BACK_MM
    # The picture's border cuts the touch on the way there: only what it left can come back.
    came = project_cloud(
        back_project_depth(depth, there, BackProjectionParams()), behind, finer
    ).source_index
    if not (came[[0, -1]] >= 0).any() and not (came[:, [0, -1]] >= 0).any():
        assert iou(again.contact, depth.contact) >= MASK_IOU
