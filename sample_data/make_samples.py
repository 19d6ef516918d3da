"""Makes the sample recordings from physics: `python -m sample_data.make_samples`.

Everything in `sample_data/recordings` comes from here; the same code gives the same pictures.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise, permutations
from pathlib import Path

import numpy as np

from pipeline import alignment, rigid
from pipeline.arrays import Doubles
from pipeline.frames import Pairing, TactileFrame
from pipeline.physics import shapes
from pipeline.physics.press import photograph, press
from pipeline.recordings.hdf5_writer import Writer
from pipeline.sensors.spec import SensorSpec, sensor

FOLDER = Path(__file__).parent / "recordings"
SENSORS = ("gelslim", "digit", "soft_bubble")
FRAMES_PER_S = 10.0
BUBBLE_STEP_MM = 0.05  # readings are kept to this; its noise is eight times as much
NOTES = (
    "simulated: exact indentation, contact and object pose are part of the file",
    "all three sensors feel the same object at the same moment; the bubble reaches 4 mm farther and touches first",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """Where the object is at one frame; between two of them it moves evenly."""

    frame: int
    face_z_mm: float  # of the tactile face over the untouched gels; negative = pressed in
    slide_mm: float = 0.0
    twist_deg: float = 0.0
    tilt_deg: float = 0.0


# Untouched, approach, press, slide, twist, lean, release, untouched.
PATH = (
    Key(frame=0, face_z_mm=9.0),
    Key(frame=1, face_z_mm=7.0),
    Key(frame=3, face_z_mm=-0.15),
    Key(frame=5, face_z_mm=-0.6),
    Key(frame=8, face_z_mm=-0.6, slide_mm=2.0),
    Key(frame=11, face_z_mm=-0.6, slide_mm=2.0, twist_deg=24.0),
    Key(frame=12, face_z_mm=-0.5, slide_mm=2.0, twist_deg=24.0, tilt_deg=2.0),
    Key(frame=13, face_z_mm=-0.1, slide_mm=2.0, twist_deg=24.0, tilt_deg=2.0),
    Key(frame=14, face_z_mm=6.0, slide_mm=2.0, twist_deg=24.0),
    Key(frame=15, face_z_mm=9.0, slide_mm=2.0, twist_deg=24.0),
)


def poses() -> Iterator[Doubles]:
    """`alignment_from_object` of every frame."""
    for before, after in pairwise(PATH):
        for frame in range(before.frame, after.frame):
            yield _pose(before, after, (frame - before.frame) / (after.frame - before.frame))
    yield _pose(PATH[-1], PATH[-1], 0.0)


def _pose(before: Key, after: Key, share: float) -> Doubles:
    def between(a: float, b: float) -> float:
        return a + share * (b - a)

    lean = rigid.rotation((np.deg2rad(between(before.tilt_deg, after.tilt_deg)), 0.0, 0.0))
    twist = rigid.rotation((0.0, 0.0, np.deg2rad(between(before.twist_deg, after.twist_deg))))
    place = rigid.translation(
        -4.0 + between(before.slide_mm, after.slide_mm), -2.5, between(before.face_z_mm, after.face_z_mm)
    )
    return place @ lean @ twist


def first_touch(path: Path) -> None:
    """A moving touch of a notched elbow, felt by all `SENSORS` at once."""
    thing, felt_by = shapes.shape("notched_elbow").mesh, [sensor(name) for name in SENSORS]
    pairings = [
        Pairing(source=a.name, target=b.name, target_from_source=alignment.between(a, b).target_from_source)
        for a, b in permutations(felt_by, 2)
    ]
    references = [photograph(s, np.zeros(s.camera.shape, np.float32), s.rest_depth_mm, _seed(0, s)) for s in felt_by]
    with Writer(
        path, object_mesh=thing, pairings=pairings, notes=NOTES, coding="row differences", depth_step_mm=BUBBLE_STEP_MM
    ) as writer:
        for index, pose in enumerate(poses()):
            for spec, reference in zip(felt_by, references, strict=True):
                felt = press(thing, pose, spec, seed=_seed(1 + index, spec))
                assert felt.converged, f"frame {index} of {spec.name} did not converge"
                frame = TactileFrame(
                    sensor=spec.name, image=felt.image, reference=reference, index=index, time_s=index / FRAMES_PER_S
                )
                writer.append(spec.name, frame, felt.truth)


def _seed(moment: int, spec: SensorSpec) -> int:
    """A noise of its own for every reading."""
    return moment * len(SENSORS) + SENSORS.index(spec.name)


def main() -> None:
    """Make every sample recording and say how large it is."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, make in (("first_touch.h5", first_touch),):
        make(FOLDER / name)
        print(f"{name}: {(FOLDER / name).stat().st_size / 1e6:.2f} MB")  # noqa: T201 - what the script is asked for


if __name__ == "__main__":
    main()
