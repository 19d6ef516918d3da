"""What each stage's column shows in 3D. Made in the background as plain arrays; only the window touches OpenGL."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from app.session.state import DisplayParams
from pipeline.base.arrays import Doubles, Floats, Image, Mask, freeze
from pipeline.geometry import rigid
from pipeline.geometry.camera import Camera
from pipeline.geometry.meshes import Mesh
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.translation.trace import Mark
from pipeline.translation.translate import Translation
from pipeline.values.frames import TactileFrame
from pipeline.values.results import Cloud, DepthMap, ObjectPose, TargetView, Touch
from widgets.colours import MEMBRANE, OBJECT, SCENE, uniform
from widgets.layers import Layer, Sight

MOST_POINTS = 16_000  # of one surface: beyond it nothing more is seen in a view this small, but drawing slows down


def of_source(frame: TactileFrame, pixels: Image, sensor: SensorSpec) -> tuple[Layer, ...]:
    """The reading laid on the untouched surface, or the measured membrane of a bubble."""
    if frame.is_depth:
        camera = frame.camera or sensor.camera
        points = camera.back_project(np.asarray(frame.image, dtype=np.float32))
    else:
        camera = sensor.camera.scaled(frame.image.shape[1] / sensor.camera.cols)
        points = camera.back_project(_rest_mm(sensor, camera))
    return (_grid("source", points, pixels),)


def of_depth(depth: DepthMap, pixels: Image, exaggeration: float) -> tuple[Layer, ...]:
    """The membrane, its indentation stretched."""
    stretched = depth.depth_mm + (1.0 - exaggeration) * depth.indentation_mm
    return (_grid("depth", depth.camera.back_project(stretched), pixels),)


def of_cloud(cloud: Cloud, target: SensorSpec, colours: NDArray[np.uint8], exaggeration: float) -> tuple[Layer, ...]:
    """The points over the target's faint rest surface."""
    points = _stretched(cloud.points_mm, target, exaggeration)
    keep = slice(None, None, max(1, math.ceil(len(points) / MOST_POINTS)))
    return (
        Layer(name="cloud", points_mm=freeze(points[keep].astype(np.float32)), rgb=colours[keep], point_px=3.0),
        membrane(target),
    )


def of_view(view: TargetView, target: SensorSpec, pixels: Image, exaggeration: float) -> tuple[Layer, ...]:
    """The surface that the target would see, over its faint rest surface."""
    rest = _rest_mm(target, view.camera)
    stretched = rest - exaggeration * (rest - view.depth_mm)
    return (_grid("view", view.camera.back_project(stretched), pixels), membrane(target))


def of_touch(touch: Touch, pixels: Image, exaggeration: float) -> tuple[Layer, ...]:
    """The target's membrane under the generated touch, wearing its picture."""
    stretched = touch.depth_mm + (1.0 - exaggeration) * touch.indentation_mm
    return (_grid("touch", touch.camera.back_project(stretched), pixels),)


def of_pose(pose: ObjectPose, mesh: Mesh | None, target: SensorSpec) -> tuple[Layer, ...]:
    """The registered points, the object where it was found, and the rest surface."""
    keep = slice(None, None, max(1, math.ceil(len(pose.scene_mm) / MOST_POINTS)))
    scene = np.asarray(pose.scene_mm[keep], dtype=np.float32)
    layers = [Layer(name="scene", points_mm=scene, rgb=uniform(SCENE, len(scene)), point_px=4.0), membrane(target)]
    if mesh is not None and pose.sensor_from_object is not None:
        layers.append(_object(mesh, pose.sensor_from_object))
    return tuple(layers)


def trace_dots(
    marks: tuple[Mark, ...], translation: Translation, display: DisplayParams
) -> dict[str, tuple[float, float, float]]:
    """Where the traced pixel is in each 3D view, on the surfaces as drawn (stretched); columns it misses are absent."""
    dots: dict[str, tuple[float, float, float]] = {}
    source, target = translation.source, translation.target
    for mark in marks:
        if mark.point_mm is None:
            continue
        if mark.stage == "depth":
            dots["source"] = _stretched_point(mark.point_mm, source, 0.0 if source.kind == "gel" else 1.0)
            dots["depth"] = _stretched_point(mark.point_mm, source, display.stretch(source))
        elif mark.stage in ("adapt", "project"):
            dots[mark.stage] = _stretched_point(mark.point_mm, target, display.stretch(target))
            if mark.index >= 0 and mark.stage == "project":
                dots["generate"] = dots["project"]
        else:
            dots[mark.stage] = mark.point_mm
    return dots


def _stretched_point(
    point_mm: tuple[float, float, float], sensor: SensorSpec, times: float
) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in _stretched(np.asarray([point_mm], dtype=np.float32), sensor, times)[0])
    return x, y, z


def sights(source: SensorSpec, target: SensorSpec, alignment: Alignment) -> dict[int, Sight]:
    """Where the six views look from: two at the source, four at that part of the target which can be touched."""
    z = float(np.median(source.rest_depth_mm))
    radius = _radius_mm(source)
    at_source = Sight(centre_mm=(0.0, 0.0, z), radius_mm=radius, frame=source.name)
    x, y, z = (float(v) for v in rigid.apply(alignment.target_from_source, (0.0, 0.0, z)))
    reach = min(_radius_mm(target), 1.4 * radius) if source.kind == "gel" else _radius_mm(target)
    at_target = Sight(centre_mm=(x, y, z), radius_mm=reach, frame=f"target {target.name}")
    return {0: at_source, 1: at_source, 2: at_target, 3: at_target, 4: at_target, 5: at_target}


_MEMBRANES: dict[int, tuple[SensorSpec, Layer]] = {}


def membrane(sensor: SensorSpec) -> Layer:
    """The rest surface within the picture, faint; the very same layer every time, so that it is drawn once."""
    known = _MEMBRANES.get(id(sensor))
    if known is not None and known[0] is sensor:
        return known[1]
    camera = sensor.camera.scaled(min(1.0, 64.0 / sensor.camera.cols))
    points, triangles, normals = _surface(camera.back_project(_rest_mm(sensor, camera)), 1)
    layer = Layer(
        name="membrane", points_mm=points, rgb=uniform(MEMBRANE, len(points)), triangles=triangles, normals=normals,
        opacity=0.22,
    )  # fmt: skip
    _MEMBRANES[id(sensor)] = (sensor, layer)
    return layer


def _object(mesh: Mesh, sensor_from_object: Doubles) -> Layer:
    points, triangles, normals = _mesh_arrays(mesh)
    return Layer(
        name="object", points_mm=points, rgb=uniform(OBJECT, len(points)), triangles=triangles, normals=normals,
        opacity=0.55, placed=sensor_from_object,
    )  # fmt: skip


_MESHES: dict[int, tuple[Mesh, tuple[Floats, NDArray[np.int32], Floats]]] = {}


def _mesh_arrays(mesh: Mesh) -> tuple[Floats, NDArray[np.int32], Floats]:
    """The mesh with corners of its own for every triangle, so that edges stay sharp; remembered by identity."""
    known = _MESHES.get(id(mesh))
    if known is not None and known[0] is mesh:
        return known[1]
    corners = mesh.vertices_mm[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    made = (
        freeze(corners.reshape(-1, 3).astype(np.float32)),
        freeze(np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)),
        freeze(np.repeat(normals, 3, axis=0).astype(np.float32)),
    )
    _MESHES.clear()
    _MESHES[id(mesh)] = (mesh, made)
    return made


def _grid(name: str, points: NDArray[np.floating], pixels: Image) -> Layer:
    here = _seen_part(points)
    points, pixels = points[here], pixels[here]
    rows, cols = points.shape[:2]
    stride = max(1, math.ceil(math.sqrt(rows * cols / MOST_POINTS)))
    xyz, triangles, normals = _surface(points, stride)
    colours = freeze(pixels[::stride, ::stride].reshape(-1, 3).copy())
    return Layer(name=name, points_mm=xyz, rgb=colours, triangles=triangles, normals=normals)


def _seen_part(points: NDArray[np.floating]) -> tuple[slice, slice]:
    """The box of rows and columns with a point: a small touch is not thinned because its picture is large."""
    seen = np.isfinite(points[..., 2])
    row, col = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    if row.size < 2 or col.size < 2:
        return slice(None), slice(None)
    return slice(int(row[0]), int(row[-1]) + 1), slice(int(col[0]), int(col[-1]) + 1)


def _surface(points: NDArray[np.floating], stride: int) -> tuple[Floats, NDArray[np.int32], Floats]:
    """Points (n, 3), triangles, normals of every `stride`-th point; triangles with a NaN corner are left out."""
    grid = np.asarray(points[::stride, ::stride], dtype=np.float32)
    rows, cols = grid.shape[:2]
    finite: Mask = np.asarray(np.isfinite(grid).all(axis=-1), dtype=np.bool_)
    triangles = _grid_triangles(rows, cols)
    if not finite.all():
        triangles = freeze(triangles[finite.ravel()[triangles].all(axis=1)])
        grid = np.where(finite[..., None], grid, np.float32(np.nanmean(grid) if finite.any() else 0.0))
    across, down = np.gradient(grid, axis=1), np.gradient(grid, axis=0)
    normals = np.cross(down, across)  # toward the camera, which looks along +z
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    flat = normals.reshape(-1, 3).astype(np.float32)
    return freeze(np.ascontiguousarray(grid.reshape(-1, 3))), triangles, freeze(flat)


@lru_cache(maxsize=16)
def _grid_triangles(rows: int, cols: int) -> NDArray[np.int32]:
    first = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)[None, :]).ravel()
    # Wound so that front faces look at the camera: OpenGL turns normals of back faces around.
    upper = np.stack([first, first + cols, first + 1], axis=-1)
    lower = np.stack([first + 1, first + cols, first + cols + 1], axis=-1)
    return freeze(np.concatenate([upper, lower]).astype(np.int32))


def _stretched(points_mm: Floats, target: SensorSpec, exaggeration: float) -> Doubles:
    points = np.array(points_mm, dtype=np.float64)
    if len(points):
        rest = target.membrane.depth_at(points[:, 0], points[:, 1])
        points[:, 2] = rest + exaggeration * (points[:, 2] - rest)
    return points


def _radius_mm(sensor: SensorSpec) -> float:
    z = float(np.median(sensor.rest_depth_mm))
    return 0.5 * math.hypot(sensor.camera.cols * z / sensor.camera.fx_px, sensor.camera.rows * z / sensor.camera.fy_px)


def _rest_mm(sensor: SensorSpec, camera: Camera) -> Doubles:
    return sensor.rest_depth_mm if camera == sensor.camera else sensor.membrane.rest_depth_mm(camera)
