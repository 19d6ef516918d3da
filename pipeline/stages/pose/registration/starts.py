"""Initial poses of a registration: faces, edges or corners of the object's box toward the
sensor, at several angles.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.geometry import rigid
from pipeline.stages.pose.registration.model import ObjectModel
from pipeline.stages.pose.registration.scene import ContactScene

FACES: dict[str, tuple[float, float, float]] = {
    "+x": (1, 0, 0),
    "-x": (-1, 0, 0),
    "+y": (0, 1, 0),
    "-y": (0, -1, 0),
    "+z": (0, 0, 1),
    "-z": (0, 0, -1),
}
EDGES: dict[str, tuple[float, float, float]] = {
    "".join(
        f"{'+' if sign > 0 else '-'}{axis}"
        for sign, axis in zip((x, y, z), "xyz", strict=True)
        if sign
    ): (x, y, z)
    for x, y, z in product((1.0, 0.0, -1.0), repeat=3)
    if abs(x) + abs(y) + abs(z) > 1
}
"""The 12 directions between two faces and the 8 between three: no other one is 46 degrees from
all of a box's.
"""
_ANCHORS = 5  # points of a face tried at the contact's centre
_MAX_ANCHORS = 24  # the same on a face larger than the contact
_N_MODEL = 4000  # points that locate a face
_SAME_MM = 0.3  # points this close are one
_MIN_LAYER_MM = 0.3  # depth below the outermost point that still touches


@dataclass(frozen=True, slots=True, kw_only=True)
class InitialPose:
    """One initial pose; poses of one `group` differ only in the point of the face."""

    sensor_from_object: Doubles  # (4, 4) mm
    group: tuple[str, int]  # face, edge or corner; index of the angle


def list_starts(
    scene: ContactScene, model: ObjectModel, face: str, n_starts: int
) -> list[InitialPose]:
    """Return `n_starts` orientations over the faces and angles in the contact plane, each at
    several points.
    """
    directions = FACES if face == "auto" else {face: FACES[face]}
    return _spread_over(scene, model, directions, max(1, n_starts // len(directions)))


def list_edge_starts(
    scene: ContactScene, model: ObjectModel, face: str, n_starts: int
) -> list[InitialPose]:
    """Return as many angles as `list_starts` gives each face, for edges and corners (of the
    face) toward the sensor.
    """
    directions = {
        n: way for n, way in EDGES.items() if face == "auto" or np.dot(way, FACES[face]) > 0
    }
    return _spread_over(
        scene, model, directions, max(1, n_starts // (len(FACES) if face == "auto" else 1))
    )


def _spread_over(
    scene: ContactScene,
    model: ObjectModel,
    directions: Mapping[str, tuple[float, float, float]],
    n_angles: int,
) -> list[InitialPose]:
    normal = scene.normals.mean(axis=0)
    normal /= np.linalg.norm(normal)
    middle = scene.points_mm.mean(axis=0)
    layer_mm = max(_MIN_LAYER_MM, float(np.ptp(scene.points_mm @ normal)))
    extent_mm = float(np.sqrt(((scene.points_mm - middle) ** 2).sum(axis=1).mean()))
    few = model.thin(_N_MODEL)
    turns = rigid.rotation(np.outer(2 * np.pi * np.arange(n_angles) / n_angles, normal))
    found: list[InitialPose] = []
    for name, way in directions.items():
        outward = np.array(way, dtype=np.float64) / np.linalg.norm(way)
        anchors = _anchors(few, outward, layer_mm, extent_mm)
        for k, turn in enumerate(turns @ _rotate_onto(outward, normal)):
            for anchor in anchors:
                pose = turn.copy()
                pose[:3, 3] = middle - turn[:3, :3] @ anchor
                found.append(InitialPose(sensor_from_object=pose, group=(name, k)))
    return found


def _anchors(model: ObjectModel, outward: Doubles, layer_mm: float, extent_mm: float) -> Doubles:
    """Return points (n, 3) of a face that may lie at the centre of a contact of rms radius
    `extent_mm`.

    The centre of the outermost layer; points half the way to its far ends; where the layer exceeds
    the contact, the centres of contact-sized pieces.
    """
    height = model.points_mm @ outward
    layer = model.points_mm[height > height.max() - layer_mm]
    middle = layer.mean(axis=0)
    far = _spread(layer, middle, max(_ANCHORS - 1, _MAX_ANCHORS), extent_mm, _ANCHORS - 1)
    # Half the way: a corner itself is rarely at the centre of a contact.
    places = [middle, *((p + middle) / 2 for p in far[: _ANCHORS - 1])]
    for place in far:
        piece = layer[((layer - place) ** 2).sum(axis=1) < (2.0 * extent_mm) ** 2].mean(axis=0)
        if min(float(np.linalg.norm(piece - other)) for other in places) > _SAME_MM:
            places.append(piece)
    return np.array(places)


def _spread(
    layer: Doubles, middle: Doubles, most: int, apart_mm: float, least: int
) -> list[Doubles]:
    """Return points far from the centre and from one another: at least `least`, then while
    `apart_mm` apart.
    """
    chosen: list[Doubles] = []
    distance = np.linalg.norm(layer - middle, axis=1)
    while len(chosen) < most:
        k = int(np.argmax(distance))
        if len(chosen) >= least and distance[k] < apart_mm:
            break
        chosen.append(layer[k])
        distance = np.minimum(distance, np.linalg.norm(layer - layer[k], axis=1))
    return chosen


def _rotate_onto(source: Doubles, target: Doubles) -> Doubles:
    """Return the smallest rotation that takes one unit vector to another."""
    axis = np.cross(source, target)
    sine = float(np.linalg.norm(axis))
    cosine = float(source @ target)
    if sine < 1e-9:
        if cosine > 0:
            return np.eye(4)
        aside = np.cross(source, np.eye(3)[int(np.argmin(np.abs(source)))])
        return rigid.rotation(aside / np.linalg.norm(aside) * np.pi)
    return rigid.rotation(axis / sine * np.arctan2(sine, cosine))
