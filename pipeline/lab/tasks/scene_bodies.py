"""Meshes that surround the object in the 3D scene of a task: boxes, rings, and the fingers of a
hand.
"""

import math
from collections.abc import Sequence

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.lab.tasks.in_hand import FINGERS, GRIP_MM, PlanarPose, press_between_fingers
from pipeline.lab.tasks.task import SceneBody
from pipeline.physics.simulation.shapes.solids import make_mesh, make_wall_faces

# half sizes of a finger's pad: GelSlim's sensing area and a part of its housing
_PAD_MM = (9.0, 11.0, 3.0)
_BOX_FACES = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))


def make_box(
    half_mm: Sequence[float], name: str, centre_mm: Sequence[float] = (0.0, 0.0, 0.0)
) -> Mesh:
    """A box of these half sizes about a centre."""
    signs = np.array(
        [[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=np.float64
    )
    triangles = [(a, b, c) for a, b, c, _ in _BOX_FACES] + [(a, c, d) for a, _, c, d in _BOX_FACES]
    return make_mesh(np.asarray(centre_mm) + signs * np.asarray(half_mm), triangles, name)


def make_ring(profile_mm: Sequence[tuple[Doubles, float]], angles_rad: Doubles, name: str) -> Mesh:
    """A closed ring about z: its profile is a sequence of radius at every angle and height."""
    around = np.column_stack([np.cos(angles_rad), np.sin(angles_rad)])
    rings = [
        np.column_stack([radius[:, None] * around, np.full(len(around), z)])
        for radius, z in (
            (np.broadcast_to(radius, angles_rad.shape), z) for radius, z in profile_mm
        )
    ]
    return make_mesh(
        np.concatenate(rings), make_wall_faces(len(rings), len(angles_rad), endless=True), name
    )


def make_fingers(
    mesh: Mesh, held: PlanarPose, hand_from_planar: Doubles | None = None
) -> tuple[SceneBody, ...]:
    """The pads of two fingers that hold an object.

    By default the task's hand is the frame of the fingers' plane.
    """
    hand_from_object = (np.eye(4) if hand_from_planar is None else hand_from_planar) @ held.matrix
    pad = make_box(_PAD_MM, "finger", (0.0, 0.0, -_PAD_MM[2]))
    return tuple(
        SceneBody(
            name=f"{finger} finger",
            mesh=pad,
            parent="hand",
            parent_from_body=freeze(
                hand_from_object @ rigid.invert(press_between_fingers(mesh, held, finger, GRIP_MM))
            ),
        )
        for finger in FINGERS
    )


def list_angles(n: int) -> Doubles:
    """`n` angles once around, in radians."""
    return 2.0 * math.pi * np.arange(n) / n
