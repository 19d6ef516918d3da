"""The sample that the window opens with: one moving touch recorded by a GelSlim, a DIGIT and a
Soft Bubble.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.geometry import rigid
from pipeline.physics.simulation import shapes
from pipeline.sensors.spec import load_sensor
from sample_data.writing import PressFrame, write_recording

SENSORS = ("gelslim", "digit", "soft_bubble")
NOTES = (
    "simulated: exact indentation, contact and object pose are part of the file",
    "all three sensors feel the same object at the same moment; the bubble reaches 4 mm farther "
    "and touches first",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Keyframe:
    """Object position at one frame, interpolated linearly between keyframes."""

    frame: int
    face_z_mm: float  # of the tactile face above the gels at rest; negative = pressed in
    slide_mm: float = 0.0
    twist_deg: float = 0.0
    tilt_deg: float = 0.0


# No contact, approach, press, slide, twist, tilt, release, no contact.
KEYFRAMES = (
    Keyframe(frame=0, face_z_mm=9.0),
    Keyframe(frame=1, face_z_mm=7.0),
    Keyframe(frame=3, face_z_mm=-0.15),
    Keyframe(frame=5, face_z_mm=-0.3),
    Keyframe(frame=8, face_z_mm=-0.3, slide_mm=2.0),
    Keyframe(frame=11, face_z_mm=-0.3, slide_mm=2.0, twist_deg=24.0),
    Keyframe(frame=12, face_z_mm=-0.3, slide_mm=2.0, twist_deg=24.0, tilt_deg=1.0),
    Keyframe(frame=13, face_z_mm=-0.2, slide_mm=2.0, twist_deg=24.0, tilt_deg=1.0),
    Keyframe(frame=14, face_z_mm=3.5, slide_mm=2.0, twist_deg=24.0),
    Keyframe(frame=15, face_z_mm=9.0, slide_mm=2.0, twist_deg=24.0),
)


def make_recording(path: Path) -> None:
    """Write a moving touch of a notched elbow, recorded by all `SENSORS`."""
    sensors = tuple(load_sensor(name) for name in SENSORS)
    frames = [PressFrame(pose=pose, sensors=sensors) for pose in interpolate_poses()]
    write_recording(path, shapes.make_shape("notched_elbow"), frames, NOTES)


def interpolate_poses() -> Iterator[Doubles]:
    """`alignment_from_object` of every frame."""
    for before, after in pairwise(KEYFRAMES):
        for frame in range(before.frame, after.frame):
            yield _pose(before, after, (frame - before.frame) / (after.frame - before.frame))
    yield _pose(KEYFRAMES[-1], KEYFRAMES[-1], 0.0)


def _pose(before: Keyframe, after: Keyframe, share: float) -> Doubles:
    def between(a: float, b: float) -> float:
        return a + share * (b - a)

    tilt = rigid.rotation((np.deg2rad(between(before.tilt_deg, after.tilt_deg)), 0.0, 0.0))
    twist = rigid.rotation((0.0, 0.0, np.deg2rad(between(before.twist_deg, after.twist_deg))))
    place = rigid.translation(
        -4.0 + between(before.slide_mm, after.slide_mm),
        -2.5,
        between(before.face_z_mm, after.face_z_mm),
    )
    return place @ tilt @ twist
