"""Extract what a touch gives a registration: the contact surface, and the space that is free.

Initial poses of a registration: faces, edges or corners of the object's box toward the
sensor, at several angles.
"""

import math
from collections.abc import Mapping
from itertools import product

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Indices, Mask, freeze
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.core.geometry.normals import compute_area_vectors
from pipeline.core.values.results import DepthErrorModel, DepthMap, ObjectPose
from pipeline.stages.pose.registration.model import ObjectModel

# correlation length: a membrane relaxes over about this
COMPUTED = DepthErrorModel(rms_mm=0.0, correlation_mm=0.5)
# cosine to the contact normal; a notch's side wall is steep, the far side of a plate is at -1
MOST_TURNED_AWAY = -0.2

# A touch transferred from a thin gel has no information deeper than that gel reached, where the
# contact ends: a bubble would have wrapped the object's shoulders, the gel never touched them.
_RIM_PERCENT = 95.0
_RIM_MM = 0.25

# A generated touch is known to its predicted error: an object may penetrate it by three times that
# (24 touches of unseen tools: translation error 0.71 mm so, 0.99 by two times, 1.27 by none).
_PREDICTED_STDS = 3.0

_MIN_PART = 10  # fewer points are no surface


@frozen
class ContactScene:
    """Contact points in the sensor frame, and the membrane that no object may penetrate."""

    points_mm: Doubles  # (n, 3)
    normals: Doubles  # (n, 3) out of the object, toward the camera
    pixel: Indices  # (n,) flat pixel of the touch
    area_mm2: float  # of the contact, along the surface
    # (rows, cols) z that bounds objects without contact; NaN outside the source's view
    membrane_mm: Floats
    # (rows, cols) distance to the nearest contact; 0 outside the source's view
    off_contact_mm: Floats
    camera: Camera
    noise_mm: float  # of single pixels
    pixel_mm: float  # width of a pixel where the contact is
    error: DepthErrorModel  # correlated error, in addition

    @property
    def no_pose(self) -> ObjectPose:
        """An unknown pose with the points of this scene."""
        return ObjectPose(
            sensor_from_object=None,
            scene_mm=freeze(self.points_mm.astype(np.float32)),
            source_index=freeze(self.pixel),
        )


def extract_scene(touch: DepthMap, max_points: int, seed: int) -> ContactScene:
    """Extract at most `max_points` contact points with normals.

    A seeded choice where there are more.
    """
    known = np.ones(touch.contact.shape, np.bool_) if touch.in_view is None else touch.in_view
    usable = touch.contact & (touch.depth_mm > MIN_DEPTH_MM) & np.isfinite(touch.depth_mm)
    top, left, rows, cols = _box(usable)
    part = np.s_[top : top + rows, left : left + cols]
    seen = touch.camera.crop(top, left, rows, cols)
    surface = seen.back_project(np.where(usable[part], touch.depth_mm[part], np.nan))
    # Contact pixels only: the membrane around a contact is not the object.
    across = compute_area_vectors(surface).reshape(-1, 3)
    area = np.linalg.norm(across, axis=1)
    chosen = np.flatnonzero(np.isfinite(area) & (area > 0))
    area_mm2 = float(area[chosen].sum())
    if chosen.size > max_points:
        chosen = np.sort(np.random.default_rng(seed).choice(chosen, max_points, replace=False))
    row, col = np.divmod(chosen, max(cols, 1))
    import cv2

    typical_mm = (
        float(np.median(touch.depth_mm[usable])) / touch.camera.fx_px if usable.any() else 0.0
    )
    off_px = np.asarray(
        cv2.distanceTransform((~usable).astype(np.uint8), cv2.DIST_L2, 5), np.float32
    )
    farthest_mm = (
        float(np.percentile(touch.depth_mm[usable], _RIM_PERCENT)) + _RIM_MM
        if usable.any()
        else 0.0
    )
    points_mm = surface.reshape(-1, 3)[chosen]
    return ContactScene(
        points_mm=points_mm,
        normals=across[chosen] / area[chosen, None],
        pixel=((row + top) * touch.camera.cols + col + left).astype(np.int32),
        area_mm2=area_mm2,
        membrane_mm=np.where(
            known,
            np.minimum(touch.depth_mm, np.float32(farthest_mm)) - _allow_penetration_mm(touch),
            np.float32(np.nan),
        ),
        off_contact_mm=np.where(known, off_px * np.float32(typical_mm), np.float32(0.0)),
        camera=touch.camera,
        noise_mm=_noise_mm(surface[..., 2]),
        pixel_mm=float(np.median(points_mm[:, 2])) / touch.camera.fx_px if len(points_mm) else 0.0,
        error=touch.error or COMPUTED,
    )


def _allow_penetration_mm(touch: DepthMap) -> Floats:
    """Return how far (rows, cols) an object may penetrate a generated touch, from its predicted
    error; else 0.
    """
    if touch.expected_error_mm is None or not touch.is_generated:
        return np.zeros(touch.contact.shape, np.float32)
    return np.float32(_PREDICTED_STDS) * np.nan_to_num(touch.expected_error_mm)


def _noise_mm(depth_mm: Doubles) -> float:
    """Return the pixel noise (mm): deviation from a surface that is straight over three pixels."""
    middle = depth_mm[1:-1, 1:-1]
    bent = (
        4.0 * middle
        - depth_mm[:-2, 1:-1]
        - depth_mm[2:, 1:-1]
        - depth_mm[1:-1, :-2]
        - depth_mm[1:-1, 2:]
    )
    bent = np.abs(bent[np.isfinite(bent)])
    return 1.4826 * float(np.median(bent)) / math.sqrt(20.0) if bent.size else 0.0


def _box(mask: Mask) -> tuple[int, int, int, int]:
    """Return (top, left, rows, cols) of the mask's bounding box; at least one pixel."""
    rows = np.flatnonzero(mask.any(axis=1))
    cols = np.flatnonzero(mask.any(axis=0))
    if not rows.size:
        return 0, 0, 1, 1
    return int(rows[0]), int(cols[0]), int(rows[-1] - rows[0]) + 1, int(cols[-1] - cols[0]) + 1


def find_in_reach(
    scene: ContactScene, model: ObjectModel, sensor_from_object: Doubles, reach_mm: float
) -> Mask:
    """Find the points (n,) of a placed object that can touch: near the scene and facing it.

    All if there is none.
    """
    turn = sensor_from_object[:3, :3]
    near = model.normals @ (scene.normals.mean(axis=0) @ turn) > MOST_TURNED_AWAY
    low = scene.points_mm.min(axis=0) - reach_mm - sensor_from_object[:3, 3]
    high = scene.points_mm.max(axis=0) + reach_mm - sensor_from_object[:3, 3]
    for axis, least, most in zip(turn, low, high, strict=True):
        along = model.points_mm @ axis
        near &= (along >= least) & (along <= most)
    return near if near.sum() >= _MIN_PART else np.ones_like(near)


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


@frozen
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
