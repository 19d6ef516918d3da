"""How exact and how fast is the touch in the other camera? Ours, both modes, against Open3D, on a
sphere.

    python -m benchmarks.reprojection

A source camera looks at a sphere of 15 mm radius 40 mm away; a target camera looks at the same
sphere from 0, 20 and 45 degrees aside. The exact depth of every target pixel is the ray-sphere
intersection; errors are means over what the surface covers less its outermost ring. "Holes" are
pixels inside that nothing was drawn in. Open3D gives a depth image and no more, so that the drawing
of the surface is what races it; the whole stage, which also says what touches the membrane, where
each pixel came from, where each point went and what is known, has rows of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import ndimage

from benchmarks.harness.results import BenchmarkResult, Measurement, PlotPoint
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, time_in_turns
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.values.results import Cloud, DepthMap, TargetDepth
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.target_depth.surface_projection import (
    PointSplatParams,
    SurfaceProjectionParams,
    project_cloud,
    rasterise_surface,
)

SURFACE = SurfaceProjectionParams()
PAPER = PointSplatParams()
_SCENES = ((0, 1), (20, 1), (45, 1), (20, 3))  # degrees aside, target resolution
RADIUS_MM = 15.0
DISTANCE_MM = 40.0
N_CONTACT = 38_000
SOURCE = Camera(rows=320, cols=427, fx_px=949.0, fy_px=949.0, cx_px=213.0, cy_px=159.5)
_CENTRE_MM = np.array([0.0, 0.0, DISTANCE_MM + RADIUS_MM])


def measure() -> BenchmarkResult:
    rows: list[Measurement] = []
    points: list[PlotPoint] = []
    notes: list[str] = []
    for angle_deg, factor in _SCENES:
        depth_map, alignment, target, exact = scene(angle_deg, factor)
        cloud = back_project_depth(depth_map, alignment, BackProjectionParams())
        calls = {
            "surface": lambda c=cloud, t=target: draw_depth(c, t),
            "surface, whole stage": lambda c=cloud, t=target: project_cloud(c, t, SURFACE).depth_mm,
            "adapt and surface": lambda d=depth_map, a=alignment, t=target: (
                reproject(d, a, t).depth_mm
            ),
            "paper": lambda c=cloud, t=target: project_cloud(c, t, PAPER).depth_mm,
            "Open3D splat": open3d_splat(cloud, target.camera),
        }
        found = {name: call() for name, call in calls.items()}
        inside = ndimage.binary_erosion(np.isfinite(found["surface"]))
        error = {name: _error(depth, exact, inside) for name, depth in found.items()}
        times = time_in_turns(calls, runs=25)
        size = f"{angle_deg} deg, {target.camera.rows}x{target.camera.cols}"
        # At 3x the splat has holes, which its error does not count; there the claim is that the
        # surface has none.
        bar = (
            Requirement(min_speedup=1.0, min_error_ratio=300.0)
            if factor == 1
            else Requirement(min_error_ratio=50.0)
        )
        for question, name, held in (
            ("reprojected sphere", "surface", bar),
            (
                "the same with mask, notes and index maps",
                "surface, whole stage",
                replace(bar, min_speedup=None),
            ),
        ):
            rows.append(
                build_measurement(
                    f"{question}, {size}",
                    peer="Open3D project_to_depth_image",
                    ours=times[name],
                    ours_error=error[name],
                    unit="mm",
                    peer_timing=times["Open3D splat"],
                    peer_error=error["Open3D splat"],
                    bar=held,
                )
            )
        points += [
            PlotPoint(
                method=f"{name}, {size}",
                ms=times[name].median_ms,
                error=error[name],
                ours=name != "Open3D splat",
            )
            for name in calls
        ]
        filled = ndimage.binary_fill_holes(np.isfinite(found["surface"]))
        holes = {name: int((filled & ~(np.nan_to_num(d) > 0)).sum()) for name, d in found.items()}
        notes.append(
            f"{size}: holes {holes['surface']} in the surface, {holes['Open3D splat']} in "
            "Open3D's splat"
        )
    rows.append(_preview())
    return BenchmarkResult(
        title="reprojection onto a sphere seen from aside",
        unit="mm",
        rows=tuple(rows),
        points=tuple(points),
        notes=tuple(notes),
    )


def reproject(
    depth: DepthMap, alignment: Alignment, target: SensorSpec, stride: int = 1
) -> TargetDepth:
    """Adapt and project in one go."""
    return project_cloud(
        back_project_depth(depth, alignment, BackProjectionParams(stride=stride)), target, SURFACE
    )


def draw_depth(cloud: Cloud, target: SensorSpec) -> np.ndarray:
    """The surface as a depth image (rows, cols)."""
    limits = {"jump_mm": SURFACE.jump_mm, "grazing_deg": SURFACE.grazing_deg}
    drawing = rasterise_surface(cloud, target.camera, target.membrane, **limits)
    return drawing.depth_mm.reshape(target.camera.shape)


def _preview() -> Measurement:
    """Adapt and project at a quarter of the resolution, as while an alignment is dragged."""
    depth_map, alignment, target, _ = scene(20, 1)
    small = target.with_camera(target.camera.scale(0.25))
    _, _, _, exact = scene(20, 0.25)

    def run() -> np.ndarray:
        return reproject(depth_map, alignment, small, stride=4).depth_mm

    depth = run()
    return build_measurement(
        "quarter-resolution preview of adapt and project",
        ours=time_in_turns({"ours": run})["ours"],
        unit="mm",
        ours_error=_error(depth, exact, ndimage.binary_erosion(np.isfinite(depth))),
        bar=Requirement(max_ms=2.0, max_error=1e-3),
    )


def _error(depth_mm: np.ndarray, exact_mm: np.ndarray, inside: np.ndarray) -> float:
    seen = inside & np.isfinite(depth_mm) & (depth_mm > 0)
    return float(np.abs(depth_mm - exact_mm)[seen].mean())


def sphere_depth_mm(camera: Camera) -> np.ndarray:
    """Exact z where each pixel's ray first meets the sphere, NaN where it misses."""
    x, y = camera.rays()
    ray = np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.ones(camera.shape)], axis=-1)
    a = (ray**2).sum(-1)
    b = ray @ _CENTRE_MM
    root = b**2 - a * (_CENTRE_MM @ _CENTRE_MM - RADIUS_MM**2)
    return np.where(root >= 0, (b - np.sqrt(np.maximum(root, 0.0))) / a, np.nan)


def scene(angle_deg: float, factor: float) -> tuple[DepthMap, Alignment, SensorSpec, np.ndarray]:
    """Source depth with a cap of 38,000 contact pixels, the alignment, a target sensor, and the
    exact target depth.
    """
    depth = sphere_depth_mm(SOURCE)
    contact = np.zeros(depth.size, dtype=bool)
    contact[np.argsort(np.nan_to_num(depth, nan=np.inf), axis=None, kind="stable")[:N_CONTACT]] = (
        True
    )
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
    camera = Camera(rows=140, cols=175, fx_px=330.0, fy_px=330.0, cx_px=87.0, cy_px=69.5).scale(
        factor
    )
    target = replace(bubble, camera=camera, rest_depth_mm=bubble.membrane.rest_depth_mm(camera))
    alignment = Alignment(alignment_from_source=turn, target_from_alignment=np.eye(4))
    return depth_map, alignment, target, sphere_depth_mm(camera)


def open3d_splat(cloud: Cloud, camera: Camera) -> Callable[[], np.ndarray]:
    """Open3D's tensor projection of the same points, as a call that gives depth with 0 =
    nothing.
    """
    import open3d as o3d

    points = o3d.t.geometry.PointCloud(o3d.core.Tensor(cloud.points_mm.copy()))
    k = o3d.core.Tensor(camera.matrix)

    def run() -> np.ndarray:
        image = points.project_to_depth_image(
            camera.cols, camera.rows, k, depth_scale=1.0, depth_max=1000.0
        )
        return image.as_tensor().numpy()[..., 0]

    return run


if __name__ == "__main__":
    print_result(measure())
