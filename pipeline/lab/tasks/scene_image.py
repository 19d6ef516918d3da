"""The scene of a rollout as an image, without a 3D library: a depth buffer in numpy, for videos."""

import math
from collections.abc import Mapping

import numpy as np

from pipeline.core.arrays import Doubles, Image, freeze
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.rasterisation import render_mesh
from pipeline.views.layers import Layer, ViewBounds

# as in the window: angle, and distance in radii of the scene
_FIELD_OF_VIEW_DEG = 28.0
_AWAY = 3.7
_AMBIENT = 0.45  # share of light from everywhere
_LIGHT = (0.3, -0.5, -0.8)  # in the camera's frame, toward the scene
_BACKGROUND = 250
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
        centre + _AWAY * bounds.radius_mm * direction
    )
    focal_px = 0.5 * min(width_px, height_px) / math.tan(0.5 * math.radians(_FIELD_OF_VIEW_DEG))
    camera = Camera(
        rows=height_px,
        cols=width_px,
        fx_px=focal_px,
        fy_px=focal_px,
        cx_px=0.5 * width_px,
        cy_px=0.5 * height_px,
    )
    return camera, camera_from_world


class SceneDrawing:
    """Draws the layers of a scene at any poses.

    What did not move since the last image is not rasterised again.
    """

    def __init__(
        self, layers: tuple[Layer, ...], camera: Camera, camera_from_world: Doubles
    ) -> None:
        self._layers = layers
        self._camera = camera
        self._camera_from_world = camera_from_world
        # layer -> its pose, depth and shade
        self._last: dict[str, tuple[bytes, tuple[Doubles, Doubles]]] = {}

    def draw(self, poses: Mapping[str, Doubles]) -> Image:
        """Solid surfaces, then faint ones, then lines over all; (rows, cols, 3)."""
        pixels = np.full((*self._camera.shape, 3), float(_BACKGROUND))
        depth = np.full(self._camera.shape, np.inf)
        surfaces = [layer for layer in self._layers if layer.triangles is not None]
        for layer in sorted(surfaces, key=lambda layer: -layer.opacity):
            own_depth, shade = self._rasterise(layer, poses[layer.name])
            front = own_depth < depth
            colour = shade[front][:, None] * layer.rgb[0].astype(np.float64)
            pixels[front] += layer.opacity * (colour - pixels[front])
            if layer.opacity == 1.0:
                depth = np.minimum(depth, own_depth)
        image = np.clip(pixels, 0, 255).astype(np.uint8)
        for layer in self._layers:
            if layer.segments is not None:
                _draw_lines(image, layer, self._camera, self._camera_from_world @ poses[layer.name])
        return freeze(image)

    def _rasterise(self, layer: Layer, pose: Doubles) -> tuple[Doubles, Doubles]:
        last = self._last.get(layer.name)
        if last is None or last[0] != pose.tobytes():
            drawn = _rasterise(layer, self._camera, self._camera_from_world @ pose)
            last = self._last[layer.name] = pose.tobytes(), drawn
        return last[1]


def _rasterise(layer: Layer, camera: Camera, camera_from_layer: Doubles) -> tuple[Doubles, Doubles]:
    """Depth, inf where there is none, and shade (rows, cols) of the nearest surface of a layer."""
    assert layer.triangles is not None
    points = rigid.apply(camera_from_layer, layer.points_mm)
    depth, triangle = render_mesh(points, layer.triangles, camera)
    a, b, c = (points[layer.triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    brightness = _AMBIENT + (1.0 - _AMBIENT) * np.abs(normals @ _normalise(np.array(_LIGHT)))
    return np.where(triangle >= 0, depth, np.inf), brightness[triangle]


def _draw_lines(image: Image, layer: Layer, camera: Camera, camera_from_layer: Doubles) -> None:
    import cv2

    assert layer.segments is not None
    places = np.stack(camera.project(rigid.apply(camera_from_layer, layer.points_mm))[:2], axis=-1)
    colour = [int(value) for value in layer.rgb[0]]
    for begin, end in places[layer.segments]:
        ends = [tuple(int(value) for value in np.round(place)) for place in (begin, end)]
        cv2.line(image, ends[0], ends[1], colour, _LINE_PX, cv2.LINE_AA)


def _normalise(vector: Doubles) -> Doubles:
    return vector / np.linalg.norm(vector)
