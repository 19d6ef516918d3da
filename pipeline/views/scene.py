"""The scene: both sensors, their surfaces and the object as 3D layers in the alignment frame A.

Presets are the directions that one looks at it from.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.derived import derive_once
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.views.colours import RECORDED_COLOUR, SOURCE_COLOUR, TARGET_COLOUR, Rgb, repeat_colour
from pipeline.views.layers import (
    FIELD_OF_VIEW_DEG,
    VIEW_DISTANCE,
    Layer,
    ViewBounds,
    make_cloud_layer,
    make_lines_layer,
)
from pipeline.views.view import to_xyz

# stages whose surface is the target's membrane, the best one first
MEMBRANE_STAGES = ("touch_depth", "touch", "target_depth")
SCENE_LETTERS = "SAT"  # source, alignment frame, target
_RECORDED_DOTS = 220
_DOT_PX = 1.5
_SURFACE_OPACITY = 0.8
_HOUSING_OPACITY = 0.1
_AXIS = 0.2  # length in distances of the rest surface from the camera
_AXES_RGB = np.array(((220, 60, 60), (60, 170, 80), (80, 120, 235)), dtype=np.uint8)
# where one looks from, and what is up: in A, z is along the optical axes, away from the cameras
SCENE_VIEWS: Mapping[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "free": ((0.4, 0.85, -0.3), (0.0, 0.0, -1.0)),
    "top": ((0.0, 0.0, -1.0), (0.0, -1.0, 0.0)),
    "side": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
    "iso": ((1.0, 1.0, -1.0), (0.0, 0.0, -1.0)),
    # from a camera, along its optical axis, in its own frame
    "source": ((0.0, 0.0, -1.0), (0.0, -1.0, 0.0)),
    "target": ((0.0, 0.0, -1.0), (0.0, -1.0, 0.0)),
}
_FILLED = 0.9  # share of the shorter side of the view that both sensors take
_FIT_STEPS = 12
_LEAST_STEP = 0.7  # the eye stays outside


@frozen
class ScenePlaces:
    """Where the frames are in the scene, which is frame A of the opened alignment, (4, 4) mm each.

    The target stays where it is: offsets move the source and A.
    """

    view_from_source: Doubles
    view_from_alignment: Doubles
    view_from_target: Doubles

    @property
    def labels(self) -> dict[str, tuple[float, float, float]]:
        """Return the letters of the frames and where they are, mm."""
        poses = self.view_from_source, self.view_from_alignment, self.view_from_target
        return {
            letter: to_xyz(pose[:3, 3]) for letter, pose in zip(SCENE_LETTERS, poses, strict=True)
        }

    def find_view(self, name: str) -> tuple[Doubles, Doubles]:
        """Return where a preset looks from and what is up, in the scene, (3,) each."""
        poses = {"source": self.view_from_source, "target": self.view_from_target}
        rotation = poses.get(name, np.eye(4))[:3, :3]
        direction, up = (rotation @ np.array(vector) for vector in SCENE_VIEWS[name])
        return direction, up


def find_scene_places(opened: Alignment, moved: Alignment) -> ScenePlaces:
    """Return the places of the frames under an alignment that was `moved` since it was opened."""
    view_from_target = rigid.invert(opened.target_from_alignment)
    return ScenePlaces(
        view_from_source=view_from_target @ moved.target_from_source,
        view_from_alignment=view_from_target @ moved.target_from_alignment,
        view_from_target=view_from_target,
    )


def make_scene_layers(
    shown: Mapping[str, Sequence[Layer]],
    source: SensorSpec,
    target: SensorSpec,
    places: ScenePlaces,
    recorded: Sequence[Layer] = (),
) -> tuple[Layer, ...]:
    """Return what stages show, by name, and both sensors, in one view.

    `recorded` is the membrane that the target itself measured: a ghost.
    """
    objects = [layer for layer in shown.get("pose", ()) if layer.name == "object"]
    name = next((name for name in MEMBRANE_STAGES if name in shown), "")
    membrane = [
        replace(layer, opacity=_SURFACE_OPACITY)
        for layer in shown.get(name, ())
        if layer.name == name
    ]
    ghosts = [
        make_cloud_layer("recorded", points, repeat_colour(RECORDED_COLOUR, len(points)), _DOT_PX)
        for layer in recorded
        for points in (layer.points_mm[:: max(1, len(layer.points_mm) // _RECORDED_DOTS)],)
    ]
    images = [
        _drape(layer, shown.get("depth", ()))
        if source.gel is not None
        else replace(layer, name="source membrane", opacity=_SURFACE_OPACITY)
        for layer in shown.get("source", ())
    ]
    placed = [
        _place((*membrane, *ghosts, *_outline("target", target)), places.view_from_target),
        _place((*images, *_outline("source", source)), places.view_from_source),
    ]
    # translucent layers cover what is listed before them: the smaller sensor is in the larger one
    if _measure_reach_mm(source) > _measure_reach_mm(target):
        placed.reverse()
    return (
        *_place(objects, places.view_from_target),
        *chain(*placed),
        _draw_links(places.labels),
    )


def _drape(image: Layer, depth: Sequence[Layer]) -> Layer:
    """Return a gel's image on the surface that was measured, where it has the image's pixels."""
    surface = next((layer for layer in depth if layer.name == "depth"), image)
    if surface.points_mm.shape != image.points_mm.shape:
        return image
    return replace(
        image,
        points_mm=surface.points_mm,
        triangles=surface.triangles,
        normals=surface.normals,
    )


def compute_scene_bounds(
    source: SensorSpec, target: SensorSpec, alignment: Alignment
) -> ViewBounds:
    """Return the view of both sensors from the side, with their cameras above the touch."""
    corners = np.concatenate(
        [
            rigid.apply(alignment.alignment_from_source, _find_corners(source)),
            rigid.apply(rigid.invert(alignment.target_from_alignment), _find_corners(target)),
        ]
    )
    direction, up = SCENE_VIEWS["free"]
    centre, radius = _fit_view(corners, np.array(direction), np.array(up))
    return ViewBounds(
        centre_mm=to_xyz(centre),
        radius_mm=radius,
        frame="alignment",
        direction=direction,
        up=up,
        origin_mm=(0.0, 0.0, 0.0),
    )


def _fit_view(corners: Doubles, direction: Doubles, up: Doubles) -> tuple[Doubles, float]:
    """Return centre and radius of the view from `direction` that shows all corners (n, 3)."""
    toward = direction / np.linalg.norm(direction)
    right = np.cross(up, toward)
    right /= np.linalg.norm(right)
    across = np.stack([right, np.cross(toward, right)])
    centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    distance = VIEW_DISTANCE * float(np.linalg.norm(corners - centre, axis=1).max())
    for _ in range(_FIT_STEPS):  # what is nearer is larger
        off = corners - centre
        seen = (off @ across.T) / (distance - off @ toward)[:, None]
        low, high = seen.min(axis=0), seen.max(axis=0)
        centre = centre + distance * (0.5 * (low + high) @ across)
        half = math.tan(0.5 * math.radians(FIELD_OF_VIEW_DEG)) * _FILLED
        distance *= max(0.5 * float((high - low).max()) / half, _LEAST_STEP)
    return centre, distance / VIEW_DISTANCE


def _place(layers: Sequence[Layer], alignment_from_layers: Doubles) -> list[Layer]:
    return [
        replace(
            layer,
            view_from_layer=alignment_from_layers
            if layer.view_from_layer is None
            else alignment_from_layers @ layer.view_from_layer,
        )
        for layer in layers
    ]


def _measure_reach_mm(sensor: SensorSpec) -> float:
    """Return the distance of the rest surface from the camera."""
    return sensor.pixel_mm * sensor.camera.fx_px


def _find_corners(sensor: SensorSpec) -> Doubles:
    """Return the camera and the corners of what it sees of the rest surface (5, 3), mm."""
    rows, cols = sensor.camera.shape
    x_px = np.array([0, cols, cols, 0]) - 0.5
    y_px = np.array([0, 0, rows, rows]) - 0.5
    ends = sensor.camera.back_project_at(x_px, y_px, np.full(4, _measure_reach_mm(sensor)))
    return np.concatenate([np.zeros((1, 3)), ends])


@derive_once
def _outline(role: str, sensor: SensorSpec) -> tuple[Layer, ...]:
    """Return a sensor's housing, which is what its camera sees, with its edges and its axes."""
    colour: Rgb = SOURCE_COLOUR if role == "source" else TARGET_COLOUR
    corners = freeze(_find_corners(sensor).astype(np.float32))
    around = np.array([(1, 2), (2, 3), (3, 4), (4, 1)])
    rays = np.array([(0, 1), (0, 2), (0, 3), (0, 4)])
    edges = corners[np.concatenate([around, rays])]
    walls = Layer(
        name=f"{role} housing",
        points_mm=corners,
        rgb=repeat_colour(colour, len(corners)),
        triangles=freeze(np.insert(around, 0, 0, axis=1).astype(np.int32)),
        opacity=_HOUSING_OPACITY,
    )
    tips = np.stack([np.zeros((3, 3)), _AXIS * corners[1, 2] * np.eye(3)], axis=1).astype(
        np.float32
    )
    return (
        make_lines_layer(f"{role} camera", edges, repeat_colour(colour, len(edges))),
        make_lines_layer(f"{role} axes", tips, _AXES_RGB),
        walls,
    )


def _draw_links(labels: Mapping[str, tuple[float, float, float]]) -> Layer:
    """Return T_S->A and T_A->T as lines from the source's camera over A to the target's."""
    s, a, t = (labels[letter] for letter in SCENE_LETTERS)
    ends = np.array([(s, a), (a, t)], dtype=np.float32)
    colours = np.array((SOURCE_COLOUR, TARGET_COLOUR), dtype=np.uint8)
    return make_lines_layer("links", ends, colours)
