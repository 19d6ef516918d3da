"""The scene: both sensors, their surfaces and the object as 3D layers in the alignment frame A."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.derived import derive_once
from pipeline.core.geometry import rigid
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.views.colours import RECORDED_COLOUR, SOURCE_COLOUR, TARGET_COLOUR, Rgb, repeat_colour
from pipeline.views.layers import Layer, ViewBounds, make_cloud_layer, make_lines_layer
from pipeline.views.view import to_xyz

# stages whose surface is the target's membrane, the best one first
MEMBRANE_STAGES = ("touch_depth", "touch", "target_depth")
_RECORDED_DOTS = 220
_DOT_PX = 1.5
_SURFACE_OPACITY = 0.8
_HOUSING_OPACITY = 0.1
_AXIS = 0.2  # length in distances of the rest surface from the camera
_AXES_RGB = np.array(((220, 60, 60), (60, 170, 80), (80, 120, 235)), dtype=np.uint8)
_DIRECTION = (0.4, 0.85, -0.3)  # from the side, the cameras above the touch
_LOWER = 0.58  # height of the view's centre between the cameras and the touch
_MARGIN = 0.9  # radius of the view in half diagonals of both sensors


def make_scene_layers(
    shown: Mapping[str, Sequence[Layer]],
    source: SensorSpec,
    target: SensorSpec,
    alignment: Alignment,
    recorded: Sequence[Layer] = (),
) -> tuple[Layer, ...]:
    """Return what stages show, by name, and both sensors, all placed in the alignment frame.

    `recorded` is the membrane that the target itself measured: a ghost.
    """
    from_source = alignment.alignment_from_source
    from_target = rigid.invert(alignment.target_from_alignment)
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
        layer
        if source.gel is not None
        else replace(layer, name="source membrane", opacity=_SURFACE_OPACITY)
        for layer in shown.get("source", ())
    ]
    placed = [
        _place((*membrane, *ghosts, *_outline("target", target)), from_target),
        _place((*images, *_outline("source", source)), from_source),
    ]
    # translucent layers cover what is listed before them: the smaller sensor is in the larger one
    if _measure_reach_mm(source) > _measure_reach_mm(target):
        placed.reverse()
    return (*_place(objects, from_target), *chain(*placed), _draw_links(alignment))


def find_scene_labels(alignment: Alignment) -> dict[str, tuple[float, float, float]]:
    """Return the letters of the frames and where they are in the alignment frame, mm."""
    return {
        "S": to_xyz(alignment.alignment_from_source[:3, 3]),
        "A": (0.0, 0.0, 0.0),
        "T": to_xyz(rigid.invert(alignment.target_from_alignment)[:3, 3]),
    }


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
    low, high = corners.min(axis=0), corners.max(axis=0)
    # perspective enlarges what is below, nearer to the eye: its middle is lower
    centre = low + np.array((0.5, 0.5, _LOWER)) * (high - low)
    return ViewBounds(
        centre_mm=to_xyz(centre),
        radius_mm=_MARGIN * 0.5 * float(np.linalg.norm(high - low)),
        frame="alignment",
        direction=_DIRECTION,
        up=(0.0, 0.0, -1.0),
        origin_mm=(0.0, 0.0, 0.0),
    )


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
    z = _measure_reach_mm(sensor)
    x_px, y_px = (
        np.array([-0.5, cols - 0.5, cols - 0.5, -0.5]),
        np.array([-0.5, -0.5, rows - 0.5, rows - 0.5]),
    )
    ends = sensor.camera.back_project_at(x_px, y_px, np.full(4, z))
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


def _draw_links(alignment: Alignment) -> Layer:
    """Return T_S->A and T_A->T as lines from the source's camera over A to the target's."""
    labels = find_scene_labels(alignment)
    ends = np.array([(labels["S"], labels["A"]), (labels["A"], labels["T"])], dtype=np.float32)
    colours = np.array((SOURCE_COLOUR, TARGET_COLOUR), dtype=np.uint8)
    return make_lines_layer("links", ends, colours)
