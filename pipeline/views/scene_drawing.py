"""Pictures of 3D layers without a 3D library, by a depth buffer in numpy: for files."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from pipeline.core.arrays import Doubles, Image, freeze
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.rasterisation import render_mesh
from pipeline.views.colours import Rgb
from pipeline.views.layers import FIELD_OF_VIEW_DEG, VIEW_DISTANCE, Layer, ViewBounds

LIGHT_BACKGROUND: Rgb = (250, 250, 250)
DARK_BACKGROUND: Rgb = (27, 29, 33)
_AMBIENT = 0.45  # share of light from everywhere
_LIGHT = (0.3, -0.5, -0.8)  # in the camera's frame, toward the scene
_LINE_PX = 2


def make_view(bounds: ViewBounds, width_px: int, height_px: int) -> tuple[Camera, Doubles]:
    """A pinhole camera that sees a scene as the window's first view does, and its pose
    camera_from_world (4, 4).
    """
    direction = _normalise(np.array(bounds.direction))
    centre = np.array(bounds.centre_mm)
    right = _normalise(np.cross(np.array(bounds.up), direction))
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = right, np.cross(-direction, right), -direction
    camera_from_world[:3, 3] = -camera_from_world[:3, :3] @ (
        centre + VIEW_DISTANCE * bounds.radius_mm * direction
    )
    focal_px = 0.5 * min(width_px, height_px) / math.tan(0.5 * math.radians(FIELD_OF_VIEW_DEG))
    camera = Camera(
        rows=height_px,
        cols=width_px,
        fx_px=focal_px,
        fy_px=focal_px,
        cx_px=0.5 * width_px,
        cy_px=0.5 * height_px,
    )
    return camera, camera_from_world


def draw_scene(
    layers: Sequence[Layer],
    camera: Camera,
    poses: Mapping[str, Doubles],
    background: Rgb = LIGHT_BACKGROUND,
) -> Image:
    """Solid surfaces, then faint ones, then points and lines over all; (rows, cols, 3).

    `poses` are those of the layers in the camera, (4, 4) by name.
    """
    pixels = np.full((*camera.shape, 3), background, np.float64)
    depth = np.full(camera.shape, np.inf)
    for layer in sorted(layers, key=lambda layer: -layer.opacity):
        if layer.triangles is None:
            continue
        points = rigid.apply(poses[layer.name], layer.points_mm)
        own_depth, triangle = render_mesh(points, layer.triangles, camera)
        a, b, c = (points[layer.triangles[:, k]] for k in range(3))
        normals = np.cross(b - a, c - a)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        shade = _AMBIENT + (1.0 - _AMBIENT) * np.abs(normals @ _normalise(np.array(_LIGHT)))
        front = (triangle >= 0) & (own_depth < depth)
        colours = shade[:, None] * layer.rgb[layer.triangles].mean(axis=1)
        pixels[front] += layer.opacity * (colours[triangle[front]] - pixels[front])
        if layer.opacity == 1.0:
            depth[front] = own_depth[front]
    image = np.clip(pixels, 0, 255).astype(np.uint8)
    for layer in layers:
        if layer.triangles is None:
            _draw_points_or_lines(image, layer, camera, poses[layer.name])
    return freeze(image)


def _draw_points_or_lines(
    image: Image, layer: Layer, camera: Camera, camera_from_layer: Doubles
) -> None:
    import cv2

    below = image if layer.opacity == 1.0 else image.copy()
    points = rigid.apply(camera_from_layer, layer.points_mm)
    places = np.rint(np.stack(camera.project(points)[:2], axis=-1))
    rgb = layer.rgb.tolist()
    if layer.segments is not None:
        for begin, end in layer.segments.tolist():
            ends = [tuple(int(value) for value in places[k]) for k in (begin, end)]
            cv2.line(image, ends[0], ends[1], rgb[begin], _LINE_PX, cv2.LINE_AA)
    else:
        for place, colour in zip(places.tolist(), rgb, strict=True):
            centre = int(place[0]), int(place[1])
            cv2.circle(image, centre, max(1, round(0.5 * layer.point_px)), colour, -1, cv2.LINE_AA)
    if below is not image:
        cv2.addWeighted(image, layer.opacity, below, 1.0 - layer.opacity, 0.0, dst=image)


def _normalise(vector: Doubles) -> Doubles:
    return vector / np.linalg.norm(vector)
