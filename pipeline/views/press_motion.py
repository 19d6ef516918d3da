"""The press in motion: a frame's scene with its depth scaled from 0 to what it is.

The object comes, the gel gives way, rays carry points of the gel over frame A to the target, whose
membrane bulges. Between rest and the frame itself nothing is recorded: the depth between is a share
of the frame's.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, freeze
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.sensors.spec import SensorSpec
from pipeline.views.colours import (
    SOURCE_COLOUR,
    TARGET_COLOUR,
    get_colour_table,
    locate_in_colour_table,
)
from pipeline.views.layers import Layer, make_lines_layer, stretch_depth
from pipeline.views.scene import MEMBRANE_STAGES, ScenePlaces

DURATION_S = 3.0
SOURCE_SURFACES = ("source", "source membrane")  # layers of a scene
# shares of the time at which a motion begins and ends
_APPROACH = 0.0, 0.2
_PRESS = 0.15, 0.42
_RAYS = 0.3, 0.62
_BULGE = 0.5, 0.74
_RELEASE = 0.9, 1.0
_LEAD = 0.12  # way of the object before it touches, in distances of the touch from its camera
_MAX_RAYS = 16
_RAY_OPACITY = 0.45
_TOUCHED = 0.3  # points moved by more than this share of the deepest have rays
_SLOPE_MM = 0.25  # over which the slope of a surface at rest is taken


@frozen
class _Surface:
    """A surface at rest, and how it moves to the frame's."""

    layer: Layer
    rest_mm: Floats  # (n, 3)
    move_mm: Floats  # (n, 3)
    rest_normals: Floats | None  # (n, 3)
    colour_index: NDArray[np.int16] | None  # (n,) in the table of its scale, -1 = not of it

    def bend(self, share: float) -> Layer:
        """Return the layer with this share of its depth; at 1 it is the frame's own."""
        if share >= 1.0:
            return self.layer
        layer, normals = self.layer, self.layer.normals
        if normals is not None and self.rest_normals is not None:
            normals = freeze(self.rest_normals + np.float32(share) * (normals - self.rest_normals))
        return replace(
            layer,
            points_mm=freeze(self.rest_mm + np.float32(share) * self.move_mm),
            normals=normals,
            rgb=self._colour(share),
        )

    def _colour(self, share: float) -> NDArray[np.uint8]:
        """Return the colours of the values times `share`."""
        scale, index = self.layer.scale, self.colour_index
        if scale is None or index is None:
            return self.layer.rgb
        zero = 255.0 * (0.0 - scale.low) / (scale.high - scale.low)
        scaled = np.clip(zero + share * (index - zero), 0.0, 255.0).astype(np.uint8)
        colours = get_colour_table(scale.colour_map)[scaled]
        return freeze(np.where(index[:, None] >= 0, colours, self.layer.rgb))


class PressMotion:
    """The layers of a scene at every time of the press."""

    def __init__(
        self,
        layers: Sequence[Layer],
        source: SensorSpec,
        target: SensorSpec,
        places: ScenePlaces,
    ) -> None:
        self._layers = tuple(layers)
        self._places = places
        self._surfaces: dict[str, _Surface] = {}
        self._joints = np.zeros((0, 3)), np.zeros((0, 3))  # of the rays at rest, and their way
        deepest_mm = 0.0
        for layer in layers:
            if layer.name in SOURCE_SURFACES:
                surface = self._surfaces[layer.name] = _make_surface(layer, source)
                deepest_mm = float(-surface.move_mm[:, 2].min(initial=0.0))
                self._joints = _choose_joints(surface)
            elif layer.name in MEMBRANE_STAGES:
                self._surfaces[layer.name] = _make_surface(layer, target)
        self._deepest_mm = deepest_mm
        self._lead_mm = _LEAD * float(np.median(source.rest_depth_mm))

    def make_layers(self, time: float) -> tuple[Layer, ...]:
        """Return the scene at a time from 0 to 1; the end is the beginning."""
        back = 1.0 - _rise(time, _RELEASE)
        source, target = _rise(time, _PRESS) * back, _rise(time, _BULGE) * back
        away_mm = (1.0 - source) * self._deepest_mm + self._lead_mm * (
            1.0 - _rise(time, _APPROACH) * back
        )
        moved: list[Layer] = []
        for layer in self._layers:
            if layer.name == "object":
                moved.append(self._move_object(layer, away_mm))
            elif (surface := self._surfaces.get(layer.name)) is not None:
                moved.append(surface.bend(source if layer.name in SOURCE_SURFACES else target))
            else:
                moved.append(layer)
        return (*moved, self._draw_rays(source, _rise(time, _RAYS) if back == 1.0 else 0.0))

    def describe(self, time: float) -> str:
        """Return how much of the frame's depth is shown at a time."""
        share = _rise(time, _PRESS) * (1.0 - _rise(time, _RELEASE))
        return f"{share:.0%} of this frame's depth"

    def _move_object(self, layer: Layer, away_mm: float) -> Layer:
        """Return the object away from the touch, along the optical axis of the source."""
        motion = np.eye(4)
        motion[:3, 3] = away_mm * self._places.view_from_source[:3, 2]
        pose = np.eye(4) if layer.view_from_layer is None else layer.view_from_layer
        return replace(layer, view_from_layer=freeze(motion @ pose))

    def _draw_rays(self, share: float, way: float) -> Layer:
        """Return the rays from the source's camera to its surface and on to the target's camera,
        as far as `way`.
        """
        rest, moves = self._joints
        joints = rigid.apply(self._places.view_from_source, rest + share * moves)
        labels = self._places.labels
        begin, end = np.array(labels["S"]), np.array(labels["T"])
        first, second = min(1.0, 2.0 * way), max(0.0, 2.0 * way - 1.0)
        ends = np.empty((2, len(joints), 2, 3))
        ends[0, :, 0], ends[0, :, 1] = begin, begin + first * (joints - begin)
        ends[1, :, 0] = ends[0, :, 1]
        ends[1, :, 1] = ends[0, :, 1] + second * (end - joints)
        colours = np.repeat(
            np.array((SOURCE_COLOUR, TARGET_COLOUR), dtype=np.uint8), len(joints), axis=0
        )
        rays = make_lines_layer("rays", ends.reshape(-1, 2, 3).astype(np.float32), colours)
        return replace(rays, opacity=_RAY_OPACITY)


def _make_surface(layer: Layer, sensor: SensorSpec) -> _Surface:
    rest = stretch_depth(layer.points_mm, sensor, 0.0)
    scale = layer.scale
    # a distance from the camera is not 0 at rest
    is_scaled = scale is not None and scale.low <= 0.0 <= scale.high
    return _Surface(
        layer=layer,
        rest_mm=freeze(rest.astype(np.float32)),
        move_mm=freeze((layer.points_mm - rest).astype(np.float32)),
        rest_normals=None if layer.normals is None else _find_normals(rest, sensor),
        colour_index=(
            locate_in_colour_table(layer.rgb, scale.colour_map)
            if scale is not None and is_scaled
            else None
        ),
    )


def _find_normals(rest_mm: Doubles, sensor: SensorSpec) -> Floats:
    """Return the normals (n, 3) of the surface at rest, toward the camera."""
    x, y, z = rest_mm.T
    along = [
        sensor.membrane.depth_at(x + _SLOPE_MM * dx, y + _SLOPE_MM * dy) - z
        for dx, dy in ((1.0, 0.0), (0.0, 1.0))
    ]
    normals = np.stack([along[0] / _SLOPE_MM, along[1] / _SLOPE_MM, -np.ones_like(z)], axis=-1)
    normals = np.where(np.isfinite(normals).all(axis=-1, keepdims=True), normals, (0.0, 0.0, -1.0))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return freeze(normals.astype(np.float32))


def _choose_joints(surface: _Surface) -> tuple[Doubles, Doubles]:
    """Return evenly chosen points that the touch moves: at rest (n, 3), and their way."""
    inward = -surface.move_mm[:, 2]
    touched = np.flatnonzero(inward > _TOUCHED * max(float(inward.max(initial=0.0)), 1e-9))
    chosen = touched[np.linspace(0, len(touched) - 1, min(len(touched), _MAX_RAYS)).astype(np.intp)]
    return surface.rest_mm[chosen].astype(np.float64), surface.move_mm[chosen].astype(np.float64)


def _rise(time: float, between: tuple[float, float]) -> float:
    """Return how far a motion is, which begins and ends gently: 0 before, 1 after."""
    begin, end = between
    at = min(1.0, max(0.0, (time - begin) / (end - begin)))
    return at * at * (3.0 - 2.0 * at)
