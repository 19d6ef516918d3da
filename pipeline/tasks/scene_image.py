"""The scene of a rollout as an image, without a 3D library: a depth buffer in numpy, for videos."""

from collections.abc import Mapping

import numpy as np

from pipeline.base.arrays import Doubles, Image, freeze
from pipeline.geometry import rigid
from pipeline.previews.layers import Layer, ViewBounds

_FIELD_OF_VIEW_DEG, _AWAY = 28.0, 3.7  # as in the window: angle, and distance in radii of the scene
_AMBIENT = 0.45  # share of light from everywhere
_LIGHT = (0.3, -0.5, -0.8)  # in the camera's frame, toward the scene
_BACKGROUND = 250
_LINE_PX = 2


class SceneCamera:
    """A pinhole camera that sees a scene as the window's first view does."""

    def __init__(self, bounds: ViewBounds, width_px: int, height_px: int) -> None:
        self.size_px = width_px, height_px
        direction, centre = _normalise(np.array(bounds.direction)), np.array(bounds.centre_mm)
        right = _normalise(np.cross(np.array(bounds.up), direction))
        rotation = np.stack([right, np.cross(-direction, right), -direction])
        position = centre + _AWAY * bounds.radius_mm * direction
        self._camera_from_world = np.eye(4)
        self._camera_from_world[:3, :3], self._camera_from_world[:3, 3] = rotation, -rotation @ position
        self._focal_px = 0.5 * min(self.size_px) / np.tan(0.5 * np.radians(_FIELD_OF_VIEW_DEG))

    def transform(self, points_mm: Doubles) -> Doubles:
        """Points (n, 3) of the world in the camera's frame: x right, y down, z away."""
        return rigid.apply(self._camera_from_world, points_mm)

    def project(self, points_mm: Doubles) -> Doubles:
        """Points (n, 3) of the camera's frame as x, y in pixels."""
        middle = 0.5 * np.array(self.size_px)
        return middle + self._focal_px * points_mm[:, :2] / np.maximum(points_mm[:, 2:], 1e-3)


class SceneDrawing:
    """Draws the layers of a scene at any poses; what did not move since the last image is not rasterised again."""

    def __init__(self, layers: tuple[Layer, ...], camera: SceneCamera) -> None:
        self._layers, self._camera = layers, camera
        self._last: dict[str, tuple[bytes, tuple[Doubles, Doubles]]] = {}  # layer -> its pose, depth and shade

    def draw(self, poses: Mapping[str, Doubles]) -> Image:
        """Solid surfaces, then faint ones, then lines over all; (rows, cols, 3)."""
        width, height = self._camera.size_px
        pixels = np.full((height, width, 3), float(_BACKGROUND))
        depth = np.full((height, width), np.inf)
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
                _draw_lines(image, layer, self._camera, poses[layer.name])
        return freeze(image)

    def _rasterise(self, layer: Layer, pose: Doubles) -> tuple[Doubles, Doubles]:
        last = self._last.get(layer.name)
        if last is None or last[0] != pose.tobytes():
            points = self._camera.transform(rigid.apply(pose, layer.points_mm.astype(np.float64)))
            drawn = _rasterise(points, self._camera.project(points), layer, self._camera.size_px)
            last = self._last[layer.name] = pose.tobytes(), drawn
        return last[1]


def _rasterise(points: Doubles, places_px: Doubles, layer: Layer, size_px: tuple[int, int]) -> tuple[Doubles, Doubles]:
    """Depth and shade (rows, cols) of the nearest surface of a layer; inf where there is none."""
    width, height = size_px
    depth, shade = np.full((height, width), np.inf), np.zeros((height, width))
    assert layer.triangles is not None
    corners = points[layer.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    brightness = _AMBIENT + (1.0 - _AMBIENT) * np.abs(normals @ _normalise(np.array(_LIGHT)))
    for k, (a, b, c) in enumerate(places_px[layer.triangles]):
        low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
        x0, y0 = (max(0, int(value)) for value in np.floor(low))
        x1, y1 = min(width, int(high[0]) + 2), min(height, int(high[1]) + 2)
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if x0 >= x1 or y0 >= y1 or area == 0.0:
            continue
        x, y = np.arange(x0, x1), np.arange(y0, y1)[:, None]
        second = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
        third = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
        first = 1.0 - second - third
        z = 1.0 / np.maximum(first / corners[k, 0, 2] + second / corners[k, 1, 2] + third / corners[k, 2, 2], 1e-9)
        window = (slice(y0, y1), slice(x0, x1))
        nearer = (first >= 0) & (second >= 0) & (third >= 0) & (z < depth[window])
        depth[window][nearer], shade[window][nearer] = z[nearer], brightness[k]
    return depth, shade


def _draw_lines(image: Image, layer: Layer, camera: SceneCamera, pose: Doubles) -> None:
    import cv2

    assert layer.segments is not None
    places = camera.project(camera.transform(rigid.apply(pose, layer.points_mm.astype(np.float64))))
    colour = [int(value) for value in layer.rgb[0]]
    for begin, end in places[layer.segments]:
        ends = [tuple(int(value) for value in np.round(place)) for place in (begin, end)]
        cv2.line(image, ends[0], ends[1], colour, _LINE_PX, cv2.LINE_AA)


def _normalise(vector: Doubles) -> Doubles:
    return vector / np.linalg.norm(vector)
