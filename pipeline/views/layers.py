"""3D layers of a value: points and surfaces as plain arrays, headless."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, Image, Indices, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.meshes import Mesh, make_grid_triangles
from pipeline.core.geometry.normals import compute_area_vectors
from pipeline.sensors.spec import SensorSpec
from pipeline.views.colours import MEMBRANE_COLOUR, OBJECT_COLOUR, ColourScale, Rgb, repeat_colour
from pipeline.views.preview import Preview, compute_rest_depth_mm

# of one surface: more are not visible in a view this small and slow rendering down
MAX_POINTS = 16_000
# of the first view: angle, and distance in radii of what it shows
FIELD_OF_VIEW_DEG = 28.0
VIEW_DISTANCE = 3.7
_FINE_TRIANGLES = 16_000  # a grid of fewer is not thinned
_MEMBRANE_COLS = 64.0  # a faint smooth surface needs no more
# points (n, 3) in mm, with triangles (m, 3) and normals (n, 3)
_Surface = tuple[Floats, NDArray[np.int32], Floats]


@dataclass(frozen=True, slots=True, weakref_slot=True, kw_only=True)
class Layer:
    """Points or a surface in one sub-view."""

    name: str  # unique in its sub-view: the same name is updated in place
    points_mm: Floats  # (n, 3)
    rgb: NDArray[np.uint8]  # (n, 3)
    scale: ColourScale | None = None  # that the colours are of; None = true colours or one colour
    triangles: Indices | None = None  # (m, 3); None = a point cloud
    segments: Indices | None = None  # or lines (m, 2)
    normals: Floats | None = None  # (n, 3) for smooth shading
    opacity: float = 1.0
    point_px: float = 3.0
    view_from_layer: Doubles | None = None  # (4, 4) rigid motion of the layer


@frozen
class ViewBounds:
    """What a sub-view shows: a sphere of `radius_mm` around `centre` fills the view."""

    centre_mm: tuple[float, float, float]
    radius_mm: float
    frame: str  # views of the same frame may share a camera
    direction: tuple[float, float, float] = (0.0, 0.6, -1.0)  # from the centre to the camera
    up: tuple[float, float, float] = (0.0, -1.0, 0.0)
    origin_mm: tuple[float, float, float] | None = None  # of the axes; None = near a corner


def make_surface_layer(
    name: str,
    depth_mm: Floats,
    indentation_mm: Floats,
    camera: Camera,
    preview: Preview,
    times: float,
) -> Layer:
    """Return a membrane (rows, cols) textured with its preview, its indentation stretched."""
    return make_grid_layer(
        name, camera.back_project(depth_mm + (1.0 - times) * indentation_mm), preview
    )


def make_frame_layer(
    name: str, image: Image | Floats, camera: Camera, preview: Preview, sensor: SensorSpec
) -> Layer:
    """Return a 3D layer of a frame's pixels, on the rest surface of a gel or on the measured
    membrane of a bubble.
    """
    if image.ndim == 2:
        return make_grid_layer(
            name, camera.back_project(np.asarray(image, dtype=np.float32)), preview
        )
    stride = _choose_stride(*camera.shape)
    return _texture_surface(
        name, _rest_surface(sensor, camera, stride), preview.pixels[::stride, ::stride], preview
    )


@derive_once
def _rest_surface(sensor: SensorSpec, camera: Camera, stride: int) -> _Surface:
    return _surface(camera.back_project(compute_rest_depth_mm(sensor, camera)), stride)


def make_cloud_layer(
    name: str,
    points_mm: Floats,
    colours: NDArray[np.uint8],
    point_px: float,
    scale: ColourScale | None = None,
) -> Layer:
    """Return points, thinned to what is visible."""
    keep = slice(None, None, max(1, math.ceil(len(points_mm) / MAX_POINTS)))
    points = freeze(np.asarray(points_mm[keep], dtype=np.float32))
    return Layer(name=name, points_mm=points, rgb=colours[keep], point_px=point_px, scale=scale)


def make_lines_layer(
    name: str, ends_mm: Floats, colours: NDArray[np.uint8], scale: ColourScale | None = None
) -> Layer:
    """Return lines between pairs of points (n, 2, 3), each in one colour (n, 3)."""
    points = freeze(np.ascontiguousarray(ends_mm, dtype=np.float32).reshape(-1, 3))
    rgb = freeze(np.repeat(colours, 2, axis=0))
    segments = freeze(np.arange(2 * len(ends_mm), dtype=np.int32).reshape(-1, 2))
    return Layer(name=name, points_mm=points, rgb=rgb, segments=segments, scale=scale)


@derive_once
def make_membrane_layer(sensor: SensorSpec) -> Layer:
    """Return the rest surface within the image, faint; one object, so that it is rendered once."""
    camera = sensor.camera.scale(min(1.0, _MEMBRANE_COLS / sensor.camera.cols))
    surface = _surface(camera.back_project(compute_rest_depth_mm(sensor, camera)), 1)
    return _make_solid_layer("membrane", surface, MEMBRANE_COLOUR, 0.22)


def make_object_layer(mesh: Mesh, sensor_from_object: Doubles) -> Layer:
    """Return the object at its estimated pose."""
    layer = make_mesh_layer("object", mesh, OBJECT_COLOUR, opacity=0.55)
    return replace(layer, view_from_layer=sensor_from_object)


def make_mesh_layer(name: str, mesh: Mesh, colour: Rgb, *, opacity: float = 1.0) -> Layer:
    """Return a mesh in its own frame."""
    return _make_solid_layer(name, _mesh_arrays(mesh), colour, opacity)


def _make_solid_layer(name: str, surface: _Surface, colour: Rgb, opacity: float) -> Layer:
    points, triangles, normals = surface
    return Layer(
        name=name,
        points_mm=points,
        rgb=repeat_colour(colour, len(points)),
        triangles=triangles,
        normals=normals,
        opacity=opacity,
    )


def stretch_depth(points_mm: NDArray[np.floating], sensor: SensorSpec, times: float) -> Doubles:
    """Return points (n, 3) with their distance from the rest surface multiplied by `times`."""
    points = np.array(points_mm, dtype=np.float64)
    if len(points):
        rest = sensor.membrane.depth_at(points[:, 0], points[:, 1])
        points[:, 2] = rest + times * (points[:, 2] - rest)
    return points


def make_grid_layer(name: str, points: NDArray[np.floating], preview: Preview) -> Layer:
    """Return a grid of points (rows, cols, 3) as a surface textured with its preview, thinned to
    what is visible.
    """
    here = _seen_part(points)
    points = points[here]
    pixels = preview.pixels[here]
    stride = _choose_stride(*points.shape[:2])
    return _texture_surface(name, _surface(points, stride), pixels[::stride, ::stride], preview)


def thin_grid(layer: Layer) -> Layer:
    """Return every other point of a whole grid, for views in motion; other layers as they are."""
    triangles, n_points = layer.triangles, len(layer.points_mm)
    if triangles is None or len(triangles) < _FINE_TRIANGLES:
        return layer
    cols = int(triangles[0, 1])
    rows = n_points // max(1, cols)
    if rows * cols != n_points or len(triangles) != 2 * (rows - 1) * (cols - 1):
        return layer
    kept = np.arange(n_points).reshape(rows, cols)[::2, ::2]
    return replace(
        layer,
        points_mm=layer.points_mm[kept.ravel()],
        rgb=layer.rgb[kept.ravel()],
        normals=None if layer.normals is None else layer.normals[kept.ravel()],
        triangles=make_grid_triangles(*kept.shape),
    )


def _choose_stride(rows: int, cols: int) -> int:
    return max(1, math.ceil(math.sqrt(rows * cols / MAX_POINTS)))


def _texture_surface(name: str, surface: _Surface, pixels: Image, preview: Preview) -> Layer:
    xyz, triangles, normals = surface
    return Layer(
        name=name,
        points_mm=xyz,
        rgb=freeze(pixels.reshape(-1, 3).copy()),
        triangles=triangles,
        normals=normals,
        scale=preview.scale,
    )


@derive_once
def _mesh_arrays(mesh: Mesh) -> _Surface:
    """Return the mesh with separate corners for every triangle, so that edges stay sharp."""
    corners = mesh.vertices_mm[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return (
        freeze(corners.reshape(-1, 3).astype(np.float32)),
        freeze(np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)),
        freeze(np.repeat(normals, 3, axis=0).astype(np.float32)),
    )


def _seen_part(points: NDArray[np.floating]) -> tuple[slice, slice]:
    """Return the box of rows and columns that have a point: a small touch in a large image is
    not thinned.
    """
    import cv2

    x, y, wide, high = cv2.boundingRect(np.isfinite(points[..., 2]).astype(np.uint8))
    if min(wide, high) < 2:
        return slice(None), slice(None)
    return slice(y, y + high), slice(x, x + wide)


def _surface(points: NDArray[np.floating], stride: int) -> _Surface:
    """Return points (n, 3), triangles and normals of every `stride`-th point, without triangles
    with a NaN corner.
    """
    grid = np.asarray(points[::stride, ::stride], dtype=np.float32)
    rows, cols = grid.shape[:2]
    finite: Mask = np.asarray(np.isfinite(grid).all(axis=-1), dtype=np.bool_)
    triangles = make_grid_triangles(rows, cols)
    across = compute_area_vectors(grid)
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    # A point without neighbours in a row or column faces the camera, which looks along +z.
    normals = np.where(length > 0, across / np.maximum(length, 1e-12), (0.0, 0.0, -1.0))
    if not finite.all():
        triangles = freeze(triangles[finite.ravel()[triangles].all(axis=1)])
        grid = np.where(
            finite[..., None], grid, np.float32(np.nanmean(grid) if finite.any() else 0.0)
        )
    flat = normals.reshape(-1, 3).astype(np.float32)
    return freeze(np.ascontiguousarray(grid.reshape(-1, 3))), triangles, freeze(flat)
