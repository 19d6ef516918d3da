"""Write a recording of single simulated presses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Image
from pipeline.core.values.frames import Pairing, TactileFrame
from pipeline.io.hdf5_writer import RecordingWriter
from pipeline.lab.recorder import BUBBLE_STEP_MM
from pipeline.physics.sensor_images import render_sensor_image
from pipeline.physics.simulation.press import simulate_press
from pipeline.physics.simulation.shapes.solids import Shape
from pipeline.sensors import alignment
from pipeline.sensors.spec import SensorSpec

FRAMES_PER_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PressFrame:
    """One frame: the object's pose and the sensor instances that record it."""

    pose: Doubles  # alignment_from_object
    sensors: tuple[SensorSpec, ...]


def write_recording(
    path: Path, shape: Shape, frames: Sequence[PressFrame], notes: Sequence[str]
) -> None:
    """Simulate all frames of an object and write them, replacing the file at `path`."""
    pairings = [
        Pairing(
            source=a.name,
            target=b.name,
            target_from_source=alignment.resolve_alignment(a, b).target_from_source,
        )
        for a, b in permutations(frames[0].sensors, 2)
    ]
    references: dict[int, Image | Floats] = {}
    with RecordingWriter(
        path,
        object_mesh=shape.mesh,
        symmetry=shape.symmetry,
        pairings=pairings,
        notes=notes,
        coding="row differences",
        depth_step_mm=BUBBLE_STEP_MM,
    ) as writer:
        for index, press_frame in enumerate(frames):
            for position, spec in enumerate(press_frame.sensors):
                # each image has its own noise
                seed = (1 + index) * len(press_frame.sensors) + position
                press = simulate_press(shape.mesh, press_frame.pose, spec, seed=seed)
                assert press.converged, f"frame {index} of {spec.name} did not converge"
                if id(spec) not in references:
                    at_rest = np.zeros(spec.camera.shape, np.float32)
                    references[id(spec)] = render_sensor_image(
                        spec, at_rest, spec.rest_depth_mm, position
                    )
                frame = TactileFrame(
                    sensor=spec.name,
                    image=press.image,
                    reference=references[id(spec)],
                    index=index,
                    time_s=index / FRAMES_PER_S,
                )
                writer.append(spec.name, frame, press.truth)
