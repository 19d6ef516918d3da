"""What physics reads of random things on random units, and what is true of it: pictures, kept, to learn from.

A picture's physical answer takes a tenth of a second, so that it is worked out once for each number and kept where a
folder is given. Physics sees what it sees of a real unit: eight bits at the sensor's own size, the sensor's description
for all it knows, no calibration. Pictures in which it finds no contact are left out: there its answer stands.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path

import numpy as np

from pipeline.base.arrays import Floats, Mask
from pipeline.calibration.calibration_table import Calibration
from pipeline.geometry import rigid
from pipeline.physics import optics
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.simulation import shapes
from pipeline.simulation.gel_images import NO_DRIFT, render_image_pair, sample_drift
from pipeline.simulation.press import simulate_press
from pipeline.simulation.random_gel_sensors import sample_gel_sensor
from pipeline.simulation.variation import vary_sensor
from pipeline.stages.depth import gel_network, gel_network_input
from pipeline.stages.depth.gel_network_input import NetworkInput
from pipeline.training import gel_presses
from pipeline.training.gel_presses import GelPress
from pipeline.training.target_touches import load_arrays, save_arrays
from pipeline.values.frames import TactileFrame

VERSION = 3  # counts up when the same number would give another picture
_DRAWS = 2
_UNTOUCHED, _DRIFTING = 0.12, 0.6  # shares: of the pictures, and of the touched ones with drift
_SENSORS = ("gelsight_mini", "gelslim", "digit")
_DEPTHS_MM = (0.15, 0.4, 0.8)


@dataclass(frozen=True, slots=True, kw_only=True)
class GelTrainingSample:
    """A picture as `network_input.Seen` has it, and what is true of it; each (120, 160)."""

    image: Floats
    reference: Floats
    slopes: Floats
    physical_px: Floats
    physical_contact: Floats
    indentation_px: Floats
    contact: Mask

    @property
    def observation(self) -> NetworkInput:
        """What the network looks at."""
        return NetworkInput(**{field.name: getattr(self, field.name) for field in fields(NetworkInput)})


def simulate_gel_sample(seed: int, index: int, presses: int, folder: str = "") -> GelTrainingSample:
    """Picture `index` of a seed, of its `presses`: the same each time; odd ones are of meshes. `folder` keeps it."""
    path = Path(folder) / f"gel_{VERSION}_{seed}_{presses}_{index}.npz" if folder else None
    found = None if path is None else load_arrays(path, GelTrainingSample)
    if found is None:
        found = _drawn(np.random.default_rng([_DRAWS, 12, seed, index]), (seed, presses), mesh=index % 2 == 1)
        if path is not None:
            save_arrays(path, found)
    return found


def _drawn(rng: np.random.Generator, pool: tuple[int, int], *, mesh: bool) -> GelTrainingSample:
    while True:
        of = sample_gel_sensor(rng)
        source = of.nominal
        if rng.random() < _UNTOUCHED:
            level = np.zeros(source.camera.shape, np.float32)
            pressed = GelPress(indentation_mm=level, contact=np.zeros(level.shape, np.bool_))
            drifted = sample_drift(rng, float(rng.uniform(0.1, 1.0)))
        else:
            pressed = gel_presses.sample_gel_press(rng, pool, source, mesh=mesh)
            drifted = sample_drift(rng, float(rng.exponential(0.3))) if rng.random() < _DRIFTING else NO_DRIFT
        touched, untouched = render_image_pair(rng, of, pressed.indentation_mm, pressed.contact, drifted)
        frame = TactileFrame(sensor=source.name, image=touched, reference=untouched)
        found = make_gel_sample(frame, source, pressed.indentation_mm, pressed.contact)
        if found.physical_contact.any():
            return found


def make_gel_sample(
    frame: TactileFrame,
    source: SensorSpec,
    indentation_mm: Floats,
    contact: Mask,
    calibration: Calibration | None = None,
) -> GelTrainingSample:
    """A frame as physics and the network see it, and what is true of it, told on the frame's own pixels."""
    _, _, seen = gel_network.estimate_physical_depth(frame, source, calibration=calibration)
    at, source = gel_network_input.make_grid(source.camera.shape), gel_network.match_pixel_size(source, calibration)
    return GelTrainingSample(
        **{field.name: getattr(seen, field.name) for field in fields(NetworkInput)},
        indentation_px=at.resample_to_grid(indentation_mm) / np.float32(source.pixel_mm * at.pixels_per_cell),
        contact=at.resample_to_grid(contact.astype(np.float32)) > np.float32(0.5),
    )  # fmt: skip


@lru_cache(maxsize=256)
def simulate_unseen_tool(index: int) -> GelTrainingSample:
    """A tool of the group "unseen" as the simulator presses it, by one of three depths, on another unit of a gel."""
    rng = np.random.default_rng([9, index])
    source = load_sensor(_SENSORS[index % 3])
    other, names = vary_sensor(source, 5000 + index), shapes.list_shapes("unseen")
    thing = shapes.make_shape(names[(index // 3) % len(names)]).mesh
    while True:
        x, y = rng.uniform(-2.5, 2.5, 2)
        pose = rigid.translation(x, y, 0.0) @ rigid.rotation((0.0, 0.0, rng.uniform(-3.0, 3.0)))
        pose[2, 3] = -_DEPTHS_MM[(index // 9) % 3] - rigid.apply(pose, thing.vertices_mm)[:, 2].min()
        felt = simulate_press(thing, pose, other, seed=index)
        if felt.converged and felt.truth.contact is not None and felt.truth.contact.any():
            break
    assert felt.truth.indentation_mm is not None
    frame = TactileFrame(sensor=source.name, image=felt.image, reference=optics.render_reference(other))
    return make_gel_sample(frame, source, felt.truth.indentation_mm, felt.truth.contact)
