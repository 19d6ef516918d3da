"""What physics reads of random things on units that differ as a lab's do, and what is true of it: kept, to learn from.

Unlike `gel_readings`, whose units nobody has built, these are `variation.varied` at strength 1, so that how bright
their lamps are is worth learning. Three readings are made of a press: the same surface, deeper or shallower (exact: a
linear layer under a thing that is stretched along its normal answers alike), in the light of three units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Image, Mask
from pipeline.geometry import rigid
from pipeline.physics import gel, optics
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.simulation import shapes
from pipeline.simulation.press import make_gel_lattice, simulate_press
from pipeline.simulation.reliefs import make_random_relief
from pipeline.simulation.variation import vary_sensor
from pipeline.stages.depth import gel_network, gel_network_input, illumination_channels
from pipeline.training.target_touches import load_arrays, sample_object_mesh, save_arrays
from pipeline.values.frames import TactileFrame

VERSION = 1  # counts up when the same number would give another reading
_SENSORS = {"gelslim": 0.42, "digit": 0.33, "gelsight_mini": 0.25}  # how likely; the first has the steepest walls
_READINGS, _UNITS = 3, 10_000_000  # of a press; where the seeds of units begin
_MESHES, _DRAWN = 0.62, 0.65  # shares: of the presses; of these, what is drawn at random beside the catalogue
_DEPTHS_MM, _LIGHT_MM, _LIGHT = (0.08, 1.1), (0.06, 0.4), 0.3  # of presses, of light ones, and their share
_ASIDE_MM, _LEAN, _LEANING = 3.2, 0.04, 0.35
_FEWEST_PX, _MOST_OF_IT, _DEEPEST_MM = 80, 0.9, 1.4
_TOLERANCE_MM, _MOST_STEPS = 5e-4, 200
_DEEP_MM = 0.25  # from here on a surface is shown shallower, else a little deeper or shallower
_SHALLOWER, _ABOUT = (0.3, 1.0), (0.7, 1.3)
_TOOL_DEPTHS_MM = (0.15, 0.4, 0.8)


@dataclass(frozen=True, slots=True, kw_only=True)
class InstanceSample:
    """What the network is shown, and what is true; lengths in depths of the physical contact."""

    fields: Floats  # (28, 120, 160)
    indentation: Floats  # (120, 160)
    contact: Mask
    depth_mm: Doubles  # () of the physical contact


def simulate_instance_sample(seed: int, index: int, folder: str = "") -> InstanceSample:
    """Reading `index` of a seed: the same each time. `folder` keeps it."""
    path = Path(folder) / f"unit_{VERSION}_{seed}_{index}.npz" if folder else None
    found = None if path is None else load_arrays(path, InstanceSample)
    if found is None:
        found = _drawn(seed, index)
        if path is not None:
            save_arrays(path, found)
    return found


@lru_cache(maxsize=64)
def simulate_unseen_tool(index: int) -> InstanceSample:
    """A tool of the group "unseen", by one of three depths, on another unit of a gel."""
    rng, names = np.random.default_rng([13, index]), shapes.list_shapes("unseen")
    source = load_sensor(list(_SENSORS)[index % 3])
    unit = vary_sensor(source, 5_000 + index)
    thing = shapes.make_shape(names[(index // 3) % len(names)]).mesh
    while True:
        pose = rigid.translation(rng.uniform(-2.5, 2.5), rng.uniform(-2.5, 2.5), 0.0) @ rigid.rotation(
            (0.0, 0.0, rng.uniform(-3.0, 3.0))
        )
        pose[2, 3] = -_TOOL_DEPTHS_MM[(index // 9) % 3] - rigid.apply(pose, thing.vertices_mm)[:, 2].min()
        felt = simulate_press(thing, pose, unit, seed=index)
        if felt.converged and felt.truth.contact is not None and felt.truth.contact.any():
            assert felt.truth.indentation_mm is not None
            found = _read(felt.image, unit, source, felt.truth.indentation_mm, felt.truth.contact)
            if found is not None:
                return found


def _drawn(seed: int, index: int) -> InstanceSample:
    number, turn = divmod(index, _READINGS)
    while True:
        source, unit, surface, touched = _press(seed, number)
        rng = np.random.default_rng([seed, number, 1 + turn])
        deeper = 1.0
        if turn:
            unit = replace(vary_sensor(source, _UNITS + index), gel=unit.gel)
            deeper = float(rng.uniform(*(_SHALLOWER if surface.max() > _DEEP_MM else _ABOUT)))
        pressed = np.asarray(surface * np.float32(deeper), np.float32)
        image = optics.render(unit, pressed, seed=int(rng.integers(2**31)))
        found = _read(image, unit, source, pressed, touched)
        if found is not None:
            return found
        number += 1_000_000  # physics sees nothing in it: another press in its place


def _read(
    image: Image | Floats, unit: SensorSpec, source: SensorSpec, pressed: Floats, touched: Mask
) -> InstanceSample | None:
    """What physics makes of a picture of `unit`, told of `source` alone; None where it finds no contact."""
    frame = TactileFrame(sensor=source.name, image=image, reference=optics.render_reference(unit))
    physical, measured, seen = gel_network.estimate_physical_depth(frame, source)
    if measured is None or not physical.contact.any():
        return None
    at, deep = gel_network_input.make_grid(source.camera.shape), gel_network_input.compute_depth_px(seen)
    depth_mm = source.pixel_mm * at.pixels_per_cell * deep
    return InstanceSample(
        fields=illumination_channels.compute_all_channels(seen, source, measured.illumination),
        indentation=at.resample_to_grid(pressed) / np.float32(depth_mm),
        contact=at.resample_to_grid(touched.astype(np.float32)) > np.float32(0.5), depth_mm=np.asarray(depth_mm),
    )  # fmt: skip


@lru_cache(maxsize=8)
def _press(seed: int, number: int) -> tuple[SensorSpec, SensorSpec, Floats, Mask]:
    """A sensor, a unit of it, and the surface (rows, cols) that something presses into it, with its contact."""
    rng = np.random.default_rng([seed, number])
    source = load_sensor(str(rng.choice(list(_SENSORS), p=list(_SENSORS.values()))))
    unit = vary_sensor(source, _UNITS + _READINGS * number)
    while True:
        depth_mm = float(rng.uniform(*_DEPTHS_MM))
        if rng.random() < _LIGHT:
            depth_mm = math.exp(rng.uniform(math.log(_LIGHT_MM[0]), math.log(_LIGHT_MM[1])))
        found = _of_mesh(rng, unit, depth_mm) if rng.random() < _MESHES else _of_relief(rng, unit, depth_mm)
        if found is not None:
            return source, unit, *found


def _of_mesh(rng: np.random.Generator, unit: SensorSpec, depth_mm: float) -> tuple[Floats, Mask] | None:
    names = shapes.list_shapes("training")
    drawn = rng.random() < _DRAWN
    thing = (
        sample_object_mesh("learned", rng, 0) if drawn else shapes.make_shape(names[int(rng.integers(len(names)))]).mesh
    )
    aside, lean = rng.uniform(-_ASIDE_MM, _ASIDE_MM, 2), rng.normal(0.0, _LEAN, 2) * (rng.random() < _LEANING)
    pose = rigid.translation(aside[0], aside[1], 0.0) @ rigid.rotation((*lean, 0.0))
    pose = pose @ rigid.rotation((0.0, 0.0, rng.uniform(-math.pi, math.pi)))
    pose[2, 3] = -depth_mm - rigid.apply(pose, thing.vertices_mm)[:, 2].min()
    felt = simulate_press(thing, pose, unit, seed=None)
    surface, touched = felt.truth.indentation_mm, felt.truth.contact
    if surface is None or touched is None or not felt.converged or np.count_nonzero(touched) < _FEWEST_PX:
        return None
    return surface, touched


def _of_relief(rng: np.random.Generator, unit: SensorSpec, depth_mm: float) -> tuple[Floats, Mask] | None:
    on = make_gel_lattice(unit)
    assert unit.gel is not None
    n, (rows, cols) = max(on.shape), unit.camera.shape
    height = make_random_relief(rng, n, max(rows, cols))
    first = [int(rng.integers(n - length + 1)) for length in on.shape]
    height = height[first[0] : first[0] + on.shape[0], first[1] : first[1] + on.shape[1]]
    overlap = np.float32(depth_mm) - (height - height.min()) * np.float32(on.step_mm)
    found = gel.press_gel(unit.gel, on.step_mm, overlap, tolerance_mm=_TOLERANCE_MM, max_steps=_MOST_STEPS)
    top, left = (on.shape[0] - rows) // 2, (on.shape[1] - cols) // 2
    seen = (slice(top, top + rows), slice(left, left + cols))
    surface, touched = found.indentation_mm[seen], found.contact[seen]
    enough = _FEWEST_PX <= np.count_nonzero(touched) <= _MOST_OF_IT * touched.size
    return (surface, touched) if found.converged and enough and float(surface.max()) < _DEEPEST_MM else None
