"""Training samples of gel depth on sensor instances that differ as a lab's do (`variation.vary_sensor`, strength 1).

The brightness of an instance's LEDs carries information there, unlike with instances sampled more widely. Each press
gives three samples: the same surface, scaled in depth (exact: a linear layer under an object stretched along its normal
answers in proportion), under the light of three instances.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

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
from pipeline.training.object_sampling import SampleCache, sample_object
from pipeline.training.target_touches import CATALOGUE_SHARE, SMALL_SHARE
from pipeline.values.frames import TactileFrame

VERSION = 1  # part of the names: incremented when the same number gives another sample
_SENSORS = {"gelslim": 0.42, "digit": 0.33, "gelsight_mini": 0.25}  # probabilities; the first has the steepest walls
_SAMPLES_PER_PRESS, _FIRST_INSTANCE = 3, 10_000_000  # first seed of the instances
_MESH_SHARE, _SAMPLED_SHARE = 0.62, 0.65  # of the presses; of the meshes, those that may be random bodies
_DEPTHS_MM, _LIGHT_MM, _LIGHT_SHARE = (0.08, 1.1), (0.06, 0.4), 0.3  # of presses, of light presses, their share
_OFFSET_MM, _TILT_RAD, _TILTED_SHARE = 3.2, 0.04, 0.35
_MIN_CONTACT_PX, _MAX_CONTACT_SHARE, _MAX_DEPTH_MM = 80, 0.9, 1.4
_TOLERANCE_MM, _MAX_STEPS = 5e-4, 200  # of the contact solver
_DEEP_MM = 0.25  # surfaces deeper than this are scaled down, shallower ones up or down
_SHRINK_RANGE, _SCALE_RANGE = (0.3, 1.0), (0.7, 1.3)
_TOOL_DEPTHS_MM = (0.15, 0.4, 0.8)


@dataclass(frozen=True, slots=True, kw_only=True)
class InstanceSample:
    """Network input and truth; lengths in depths of the physical contact."""

    fields: Floats  # (28, 120, 160)
    indentation: Floats  # (120, 160)
    contact: Mask
    depth_mm: Doubles  # () depth of the physical contact


_samples = SampleCache(InstanceSample, max_bytes=1 << 28)


def simulate_instance_sample(seed: int, index: int, folder: str = "") -> InstanceSample:
    """Sample `index` of a seed, the same on every call."""
    return _samples.get(f"instance_{VERSION}_{seed}_{index}", folder, lambda: _simulate_sample(seed, index))


@lru_cache(maxsize=64)
def simulate_unseen_tool(index: int) -> InstanceSample:
    """A tool of the group "unseen", pressed to one of three depths on another sensor instance."""
    rng, names = np.random.default_rng([13, index]), shapes.list_shapes("unseen")
    nominal = load_sensor(list(_SENSORS)[index % 3])
    instance = vary_sensor(nominal, 5_000 + index)
    mesh = shapes.make_shape(names[(index // 3) % len(names)]).mesh
    while True:
        pose = rigid.translation(rng.uniform(-2.5, 2.5), rng.uniform(-2.5, 2.5), 0.0) @ rigid.rotation(
            (0.0, 0.0, rng.uniform(-3.0, 3.0))
        )
        pose[2, 3] = -_TOOL_DEPTHS_MM[(index // 9) % 3] - rigid.apply(pose, mesh.vertices_mm)[:, 2].min()
        press = simulate_press(mesh, pose, instance, seed=index)
        if press.converged and press.contact.any():
            sample = _make_sample(press.image, instance, nominal, press.indentation_mm, press.contact)
            if sample is not None:
                return sample


def _simulate_sample(seed: int, index: int) -> InstanceSample:
    number, repeat = divmod(index, _SAMPLES_PER_PRESS)
    while True:
        nominal, instance, surface, contact = _simulate_press(seed, number)
        rng = np.random.default_rng([seed, number, 1 + repeat])
        scale = 1.0
        if repeat:
            instance = replace(vary_sensor(nominal, _FIRST_INSTANCE + index), gel=instance.gel)
            scale = float(rng.uniform(*(_SHRINK_RANGE if surface.max() > _DEEP_MM else _SCALE_RANGE)))
        scaled = np.asarray(surface * np.float32(scale), np.float32)
        image = optics.render(instance, scaled, seed=int(rng.integers(2**31)))
        sample = _make_sample(image, instance, nominal, scaled, contact)
        if sample is not None:
            return sample
        number += 1_000_000  # no contact is detected: another press in its place


def _make_sample(
    image: Image | Floats, instance: SensorSpec, nominal: SensorSpec, indentation_mm: Floats, contact: Mask
) -> InstanceSample | None:
    """The physical estimate from an image of `instance` read as `nominal`; None where it detects no contact."""
    frame = TactileFrame(sensor=nominal.name, image=image, reference=optics.render_reference(instance))
    physical, measured, channels = gel_network.estimate_physical_depth(frame, nominal)
    if measured is None or not physical.contact.any():
        return None
    grid, depth_px = gel_network_input.make_grid(nominal.camera.shape), gel_network_input.compute_depth_px(channels)
    depth_mm = nominal.pixel_mm * grid.pixels_per_cell * depth_px
    return InstanceSample(
        fields=illumination_channels.compute_all_channels(channels, nominal, measured.illumination),
        indentation=grid.resample_to_grid(indentation_mm) / np.float32(depth_mm),
        contact=grid.resample_to_grid(contact.astype(np.float32)) > np.float32(0.5), depth_mm=np.asarray(depth_mm),
    )  # fmt: skip


@lru_cache(maxsize=8)
def _simulate_press(seed: int, number: int) -> tuple[SensorSpec, SensorSpec, Floats, Mask]:
    """Nominal sensor, instance, and the indentation (rows, cols) in mm that an object makes, with its contact."""
    rng = np.random.default_rng([seed, number])
    nominal = load_sensor(str(rng.choice(list(_SENSORS), p=list(_SENSORS.values()))))
    instance = vary_sensor(nominal, _FIRST_INSTANCE + _SAMPLES_PER_PRESS * number)
    while True:
        depth_mm = float(rng.uniform(*_DEPTHS_MM))
        if rng.random() < _LIGHT_SHARE:
            depth_mm = math.exp(rng.uniform(math.log(_LIGHT_MM[0]), math.log(_LIGHT_MM[1])))
        press = _press_mesh if rng.random() < _MESH_SHARE else _press_relief
        surface = press(rng, instance, depth_mm)
        if surface is not None:
            return nominal, instance, *surface


def _press_mesh(rng: np.random.Generator, sensor: SensorSpec, depth_mm: float) -> tuple[Floats, Mask] | None:
    names = shapes.list_shapes("training")
    if rng.random() < _SAMPLED_SHARE:
        _, mesh = sample_object("training", rng, 0, catalogue_share=CATALOGUE_SHARE, small_share=SMALL_SHARE)
    else:
        mesh = shapes.make_shape(names[int(rng.integers(len(names)))]).mesh
    offset, tilt = rng.uniform(-_OFFSET_MM, _OFFSET_MM, 2), rng.normal(0.0, _TILT_RAD, 2)
    tilt *= rng.random() < _TILTED_SHARE
    pose = rigid.translation(offset[0], offset[1], 0.0) @ rigid.rotation((*tilt, 0.0))
    pose = pose @ rigid.rotation((0.0, 0.0, rng.uniform(-math.pi, math.pi)))
    pose[2, 3] = -depth_mm - rigid.apply(pose, mesh.vertices_mm)[:, 2].min()
    press = simulate_press(mesh, pose, sensor, seed=None)
    if not press.converged or np.count_nonzero(press.contact) < _MIN_CONTACT_PX:
        return None
    return press.indentation_mm, press.contact


def _press_relief(rng: np.random.Generator, sensor: SensorSpec, depth_mm: float) -> tuple[Floats, Mask] | None:
    lattice = make_gel_lattice(sensor)
    assert sensor.gel is not None
    n, (rows, cols) = max(lattice.shape), sensor.camera.shape
    height = make_random_relief(rng, n, max(rows, cols))
    first = [int(rng.integers(n - length + 1)) for length in lattice.shape]
    height = height[first[0] : first[0] + lattice.shape[0], first[1] : first[1] + lattice.shape[1]]
    overlap = np.float32(depth_mm) - (height - height.min()) * np.float32(lattice.step_mm)
    pressed = gel.press_gel(sensor.gel, lattice.step_mm, overlap, tolerance_mm=_TOLERANCE_MM, max_steps=_MAX_STEPS)
    top, left = (lattice.shape[0] - rows) // 2, (lattice.shape[1] - cols) // 2
    view = (slice(top, top + rows), slice(left, left + cols))
    surface, contact = pressed.indentation_mm[view], pressed.contact[view]
    enough = _MIN_CONTACT_PX <= np.count_nonzero(contact) <= _MAX_CONTACT_SHARE * contact.size
    return (surface, contact) if pressed.converged and enough and float(surface.max()) < _MAX_DEPTH_MM else None
