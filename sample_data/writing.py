"""Presses that were thought out one by one, as a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Image
from pipeline.recordings.hdf5_writer import RecordingWriter
from pipeline.sensors import alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.simulation.press import render_sensor_image, simulate_press
from pipeline.simulation.recorder import BUBBLE_STEP_MM
from pipeline.simulation.shapes.shape import Shape
from pipeline.values.frames import Pairing, TactileFrame

FRAMES_PER_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PressFrame:
    """One frame: where the object is, and the units of the sensors that feel it."""

    pose: Doubles  # alignment_from_object
    sensors: tuple[SensorSpec, ...]


def write_recording(path: Path, thing: Shape, shots: Sequence[PressFrame], notes: Sequence[str]) -> None:
    """Record all shots of `thing`; what stood at `path` is replaced."""
    pairings = [
        Pairing(source=a.name, target=b.name, target_from_source=alignment.resolve_alignment(a, b).target_from_source)
        for a, b in permutations(shots[0].sensors, 2)
    ]
    references: dict[int, Image | Floats] = {}
    with RecordingWriter(
        path, object_mesh=thing.mesh, symmetry=thing.symmetry, pairings=pairings, notes=notes, coding="row differences",
        depth_step_mm=BUBBLE_STEP_MM,
    ) as writer:  # fmt: skip
        for index, shot in enumerate(shots):
            for place, spec in enumerate(shot.sensors):
                seed = (1 + index) * len(shot.sensors) + place  # a noise of its own for every reading
                felt = simulate_press(thing.mesh, shot.pose, spec, seed=seed)
                assert felt.converged, f"frame {index} of {spec.name} did not converge"
                if id(spec) not in references:
                    still = np.zeros(spec.camera.shape, np.float32)
                    references[id(spec)] = render_sensor_image(spec, still, spec.rest_depth_mm, place)
                frame = TactileFrame(
                    sensor=spec.name, image=felt.image, reference=references[id(spec)], index=index,
                    time_s=index / FRAMES_PER_S,
                )  # fmt: skip
                writer.append(spec.name, frame, felt.truth)
