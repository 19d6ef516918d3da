"""Where a registration may begin: each face of the object toward the sensor, at several angles and places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline import rigid
from pipeline.arrays import Doubles
from pipeline.registration.model import Model
from pipeline.registration.scene import Scene

FACES: dict[str, tuple[float, float, float]] = {
    "+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1),
}  # fmt: skip
_ANCHORS = 5  # places of a face that are tried at the middle of the contact
_MIN_LAYER_MM = 0.3  # how deep below the outermost point a face still counts as touched


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """One first guess; guesses of one `group` differ only in the place of the face."""

    sensor_from_object: Doubles  # (4, 4) mm
    group: tuple[str, int]  # face, number of the angle


def starts(scene: Scene, model: Model, face: str, n_starts: int) -> list[Start]:
    """`n_starts` orientations spread over the faces and the angles in the contact plane, each at several places."""
    faces = tuple(FACES) if face == "auto" else (face,)
    n_angles = max(1, n_starts // len(faces))
    normal = scene.normals.mean(axis=0)
    normal /= np.linalg.norm(normal)
    middle = scene.points_mm.mean(axis=0)
    layer_mm = max(_MIN_LAYER_MM, float(np.ptp(scene.points_mm @ normal)))
    found: list[Start] = []
    for name in faces:
        outward = np.array(FACES[name], dtype=np.float64)
        anchors = _anchors(model, outward, layer_mm)
        onto = _turn_onto(outward, normal)
        for k in range(n_angles):
            turn = rigid.rotation(normal * (2 * np.pi * k / n_angles)) @ onto
            for anchor in anchors:
                pose = turn.copy()
                pose[:3, 3] = middle - turn[:3, :3] @ anchor
                found.append(Start(sensor_from_object=pose, group=(name, k)))
    return found


def _anchors(model: Model, outward: Doubles, layer_mm: float) -> Doubles:
    """The middle of the outermost layer of a face, and points of it far from one another."""
    height = model.points_mm @ outward
    layer = model.points_mm[height > height.max() - layer_mm]
    chosen = [layer.mean(axis=0)]
    distance = np.linalg.norm(layer - chosen[0], axis=1)
    while len(chosen) < _ANCHORS:
        # Half the way out: a corner itself is rarely what lies in the middle of a contact.
        far = layer[int(np.argmax(distance))]
        chosen.append(far)
        distance = np.minimum(distance, np.linalg.norm(layer - far, axis=1))
    middle = chosen[0]
    return np.array([middle, *((p + middle) / 2 for p in chosen[1:])])


def _turn_onto(source: Doubles, target: Doubles) -> Doubles:
    """The smallest rotation that takes one unit vector to another."""
    axis = np.cross(source, target)
    sine, cosine = float(np.linalg.norm(axis)), float(source @ target)
    if sine < 1e-9:
        if cosine > 0:
            return rigid.identity()
        aside = np.cross(source, np.eye(3)[int(np.argmin(np.abs(source)))])
        return rigid.rotation(aside / np.linalg.norm(aside) * np.pi)
    return rigid.rotation(axis / sine * np.arctan2(sine, cosine))
