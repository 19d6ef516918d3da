"""The scene of the projection's benchmarks: a source camera and a target camera look at one sphere from two sides.

The exact depth of every pixel is where its ray first meets the sphere. Not a question itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pipeline.geometry import rigid
from pipeline.geometry.camera import Camera
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.values.results import Cloud, DepthMap

RADIUS_MM, DISTANCE_MM, N_CONTACT = 15.0, 40.0, 38_000
SOURCE = Camera(rows=320, cols=427, fx_px=949.0, fy_px=949.0, cx_px=213.0, cy_px=159.5)
_CENTRE_MM = np.array([0.0, 0.0, DISTANCE_MM + RADIUS_MM])


def sphere_depth_mm(camera: Camera) -> np.ndarray:
    """Exact z where each pixel's ray first meets the sphere, NaN where it misses."""
    x, y = camera.rays()
    ray = np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.ones(camera.shape)], axis=-1)
    a, b = (ray**2).sum(-1), ray @ _CENTRE_MM
    root = b**2 - a * (_CENTRE_MM @ _CENTRE_MM - RADIUS_MM**2)
    return np.where(root >= 0, (b - np.sqrt(np.maximum(root, 0.0))) / a, np.nan)


def scene(angle_deg: float, factor: float) -> tuple[DepthMap, Alignment, SensorSpec, np.ndarray]:
    """Source depth with a cap of 38,000 contact pixels, the alignment, a target sensor, and the exact target depth."""
    depth = sphere_depth_mm(SOURCE)
    contact = np.zeros(depth.size, dtype=bool)
    contact[np.argsort(np.nan_to_num(depth, nan=np.inf), axis=None, kind="stable")[:N_CONTACT]] = True
    depth_map = DepthMap(
        indentation_mm=np.zeros(SOURCE.shape, np.float32),
        depth_mm=depth.astype(np.float32),
        contact=contact.reshape(SOURCE.shape),
        camera=SOURCE,
        source_index=np.arange(depth.size, dtype=np.int32).reshape(SOURCE.shape),
    )
    rotation = rigid.rotation([0.0, np.deg2rad(angle_deg), 0.0])
    turn = rigid.translation(*_CENTRE_MM) @ rotation @ rigid.translation(*-_CENTRE_MM)
    bubble = load_sensor("soft_bubble")
    camera = Camera(rows=140, cols=175, fx_px=330.0, fy_px=330.0, cx_px=87.0, cy_px=69.5).scale(factor)
    target = replace(bubble, camera=camera, rest_depth_mm=bubble.membrane.rest_depth_mm(camera))
    alignment = Alignment(alignment_from_source=turn, target_from_alignment=np.eye(4))
    return depth_map, alignment, target, sphere_depth_mm(camera)


def open3d_splat(cloud: Cloud, camera: Camera) -> Callable[[], np.ndarray]:
    """Open3D's tensor projection of the same points, as a call that gives depth with 0 = nothing."""
    import open3d as o3d

    points = o3d.t.geometry.PointCloud(o3d.core.Tensor(cloud.points_mm.copy()))
    k = o3d.core.Tensor(camera.matrix)

    def run() -> np.ndarray:
        image = points.project_to_depth_image(camera.cols, camera.rows, k, depth_scale=1.0, depth_max=1000.0)
        return image.as_tensor().numpy()[..., 0]

    return run
