"""How quick is the z-buffer of a contact cloud? Ours beside Open3D's tensor projection, and beside numpy.

    python -m benchmarks.zbuffer

38,000 points of a sphere are given; the target image is 140x175 and smaller or larger. The values are compared pixel
by pixel first; the error is the largest difference from a float64 reference by sorting. Open3D works out the pixel in
float32, so a point within some 1e-5 px of the border of a pixel may go to its neighbour there.
"""

from __future__ import annotations

import numpy as np

from benchmarks.harness.results import BenchmarkResult, Measurement, PlotPoint
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, time_in_turns
from benchmarks.scenes.sphere_scene import open3d_splat, scene
from pipeline.geometry.camera import Camera
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.target_depth.rasterisation import assign_pixels, compute_zbuffer
from pipeline.stages.target_depth.surface_projection import PointSplatParams, project_cloud


def by_sorting(points_mm: np.ndarray, camera: Camera) -> np.ndarray:
    x_px, y_px, visible = camera.project(points_mm)
    pixel = (np.floor(y_px + 0.5) * camera.cols + np.floor(x_px + 0.5))[visible].astype(np.int64)
    depth = np.full(camera.rows * camera.cols, np.nan, np.float32)
    far_first = np.argsort(-points_mm[visible, 2], kind="stable")
    depth[pixel[far_first]] = points_mm[visible, 2][far_first]
    return depth.reshape(camera.shape)


def _differing(one: np.ndarray, other: np.ndarray) -> tuple[float, int]:
    """Largest difference, 0 = nothing drawn, and the number of pixels that differ."""
    off = np.abs(np.nan_to_num(one) - np.nan_to_num(other))
    return float(off.max()), int((off > 0).sum())


def measure() -> BenchmarkResult:
    rows: list[Measurement] = []
    points: list[PlotPoint] = []
    notes: list[str] = []
    for factor in (0.5, 1.0, 2.0):
        depth_map, alignment, target, _ = scene(20.0, factor)
        cloud = back_project_depth(depth_map, alignment, BackProjectionParams())
        camera = target.camera
        peer = open3d_splat(cloud, camera)
        calls = {
            "ours": lambda c=cloud, k=camera: compute_zbuffer(c, k, assign_pixels(c, k)[0])[0].reshape(k.shape),
            "the whole stage": lambda c=cloud, t=target: project_cloud(c, t, PointSplatParams()).depth_mm,
            "Open3D": peer,
            "numpy": lambda c=cloud, k=camera: by_sorting(c.points_mm, k),
        }
        exact = by_sorting(cloud.points_mm, camera)
        off = {name: _differing(call(), exact) for name, call in calls.items()}
        times = time_in_turns(calls)
        size = f"{camera.rows}x{camera.cols}"
        rows.append(build_measurement(
            f"z-buffer: {len(cloud.points_mm):,} points to {size}", peer="Open3D project_to_depth_image", unit="mm",
            ours=times["ours"], ours_error=off["ours"][0], peer_timing=times["Open3D"], peer_error=off["Open3D"][0],
            bar=Requirement(min_speedup=5.0, max_error=0.0),
        ))  # fmt: skip
        if factor == 1.0:
            rows.append(build_measurement(
                f"paper mode with mask and index maps, {size}", peer="Open3D project_to_depth_image", unit="mm",
                ours=times["the whole stage"], ours_error=off["the whole stage"][0], peer_timing=times["Open3D"],
                peer_error=off["Open3D"][0], bar=Requirement(min_speedup=1.0, max_error=0.0),
            ))  # fmt: skip
        points += [
            PlotPoint(method=f"{name}, {size}", ms=times[name].median_ms, error=off[name][0], ours=name == "ours")
            for name in ("ours", "Open3D", "numpy")
        ]
        notes.append(
            f"{size}: {off['ours'][1]} pixels of ours and {off['Open3D'][1]} of Open3D's are not as by sorting"
        )
    return BenchmarkResult(title="z-buffer of a contact cloud", unit="mm", rows=tuple(rows), points=tuple(points),
                  notes=tuple(notes))  # fmt: skip


if __name__ == "__main__":
    print_result(measure())
