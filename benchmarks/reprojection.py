"""How exact and how fast is the touch in the other camera? Ours, both modes, against Open3D, on a sphere.

A source camera looks at a sphere of 15 mm radius 40 mm away; a target camera looks at the same sphere from 0, 20 and 45
degrees aside. The exact depth of every target pixel is the ray-sphere intersection. Runs are interleaved.

    python benchmarks/reprojection.py
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pipeline import rigid
from pipeline.alignment import Alignment
from pipeline.camera import Camera
from pipeline.sensors.spec import SensorSpec, sensor
from pipeline.stages.adapt import AdaptParams, adapt
from pipeline.stages.project import ProjectParams, project
from pipeline.stages.results import Cloud, DepthMap

RADIUS_MM, DISTANCE_MM, CAP_MM, RUNS = 15.0, 40.0, 0.72, 25
SURFACE, PAPER = ProjectParams(mode="surface"), ProjectParams(mode="paper")


def sphere_depth_mm(camera: Camera, centre_mm: np.ndarray) -> np.ndarray:
    """Exact z where each pixel's ray first meets the sphere, NaN where it misses."""
    x, y = camera.rays()
    ray = np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.ones(camera.shape)], axis=-1)
    a, b = (ray**2).sum(-1), ray @ centre_mm
    root = b**2 - a * (centre_mm @ centre_mm - RADIUS_MM**2)
    return np.where(root >= 0, (b - np.sqrt(np.maximum(root, 0.0))) / a, np.nan)


def scene(angle_deg: float, factor: float) -> tuple[DepthMap, Alignment, SensorSpec, np.ndarray]:
    """Source depth of a cap of the sphere, the alignment, a target sensor, and the exact target depth."""
    source = Camera(rows=320, cols=427, fx_px=949.0, fy_px=949.0, cx_px=213.0, cy_px=159.5)
    centre = np.array([0.0, 0.0, DISTANCE_MM + RADIUS_MM])
    depth = sphere_depth_mm(source, centre)
    contact = np.isfinite(depth) & (depth < DISTANCE_MM + CAP_MM)
    depth_map = DepthMap(
        indentation_mm=np.zeros(source.shape, np.float32),
        depth_mm=depth.astype(np.float32),
        contact=contact,
        camera=source,
        source_index=np.arange(depth.size, dtype=np.int32).reshape(depth.shape),
    )
    turn = rigid.translation(*centre) @ rigid.rotation([0.0, np.deg2rad(angle_deg), 0.0]) @ rigid.translation(*-centre)
    bubble = sensor("soft_bubble")
    camera = replace(bubble.camera, cx_px=87.0, cy_px=69.5, fx_px=330.0, fy_px=330.0).scaled(factor)
    target = replace(bubble, camera=camera, rest_depth_mm=bubble.membrane.rest_depth_mm(camera))
    exact = sphere_depth_mm(camera, centre)
    return depth_map, Alignment(alignment_from_source=turn, target_from_alignment=np.eye(4)), target, exact


def open3d_splat(cloud: Cloud, camera: Camera) -> Callable[[], np.ndarray]:
    """Open3D's tensor projection of the same points, as a call that gives depth with 0 = nothing."""
    import open3d as o3d

    points = o3d.t.geometry.PointCloud(o3d.core.Tensor(cloud.points_mm.copy()))
    k = o3d.core.Tensor(camera.matrix)

    def run() -> np.ndarray:
        image = points.project_to_depth_image(camera.cols, camera.rows, k, depth_scale=1.0, depth_max=1000.0)
        return image.as_tensor().numpy()[..., 0]

    return run


def errors(depth_mm: np.ndarray, exact_mm: np.ndarray, inside: np.ndarray) -> str:
    """Coverage of `inside`, and mean, p99 and largest error there."""
    seen = inside & np.isfinite(depth_mm) & (depth_mm > 0)
    error = np.abs(depth_mm - exact_mm)[seen]
    return f"{seen.sum() / inside.sum():8.3f} {error.mean():10.6f} {np.percentile(error, 99):10.6f} {error.max():10.6f}"


def main() -> None:
    print(f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}")
    print(f"median and p95 of {RUNS} interleaved runs; errors where the surface is drawn, less its outermost ring")
    print(f"{'scene':22}{'method':20}{'coverage':>9}{'MAE mm':>11}{'p99 mm':>11}{'max mm':>11}{'ms':>9}{'p95 ms':>9}")
    for angle_deg, factor in ((0, 1), (0, 3), (20, 1), (45, 1)):
        depth_map, alignment, target, exact = scene(angle_deg, factor)
        cloud = adapt(depth_map, alignment, AdaptParams())
        calls = {
            "adapt": lambda d=depth_map, a=alignment: adapt(d, a, AdaptParams()),
            "surface": lambda c=cloud, t=target: project(c, t, SURFACE).depth_mm,
            "paper": lambda c=cloud, t=target: project(c, t, PAPER).depth_mm,
            "open3d splat only": open3d_splat(cloud, target.camera),
        }
        found = {name: call() for name, call in calls.items()}
        # The inside of the touch: where the triangles of the exact grid lie, its outermost ring taken off.
        inside = _eroded(np.isfinite(found["surface"]))
        times: dict[str, list[float]] = {name: [] for name in calls}
        for _run in range(RUNS):
            for name, call in calls.items():
                start = time.perf_counter()
                call()
                times[name].append((time.perf_counter() - start) * 1e3)
        label = f"{angle_deg} deg, {target.camera.cols}x{target.camera.rows}"
        for name in calls:
            told = (
                errors(found[name], exact, inside) if name != "adapt" else f"{len(cloud.points_mm):8} points".ljust(41)
            )
            print(f"{label:22}{name:20}{told}{np.median(times[name]):9.2f}{np.percentile(times[name], 95):9.2f}")


def _eroded(mask: np.ndarray) -> np.ndarray:
    padded = np.pad(mask, 1)
    return mask & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]


if __name__ == "__main__":
    main()
