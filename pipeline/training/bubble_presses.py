"""Simulated presses of bubbles: objects of the catalogue and random bodies on sensor instances that differ.

The contact depends on a number alone and is cached; the depth camera's noise is sampled on every use (`bubble_noise`).
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from pipeline.base.arrays import Floats, Mask
from pipeline.geometry import membrane, rigid
from pipeline.geometry.meshes import Mesh
from pipeline.physics import bubble_camera, lattice
from pipeline.sensors.parts import Bubble
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.simulation import poses, variation
from pipeline.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.simulation.press import move_bubble_closer, simulate_press
from pipeline.training.object_sampling import DATA_SPLITS, DataSplit, sample_object
from pipeline.training.sample_cache import SampleCache

VERSION = 2  # part of the seeds: incremented when the same number gives another press
MAX_GAP_MM = 8.0  # larger gaps are stored as this: nothing in a frame tells them apart
_N_GEOMETRIES = 12  # bubbles of other shapes and cameras, besides the nominal one
_NOMINAL_SHARE, _CATALOGUE_SHARE, _AS_RECORDED_SHARE = 0.6, 0.33, 0.6  # in training: nominal geometries, training
# objects, and poses and approach as in the data sets


@dataclass(frozen=True, slots=True, kw_only=True)
class BubblePress:
    """The exact state of a bubble under an object; arrays (rows, cols)."""

    sensor: SensorSpec  # the instance
    indentation_mm: Floats  # rest depth - depth of the membrane
    gap_mm: Floats  # from the membrane to the object behind it along z, 0 to MAX_GAP_MM
    contact: Mask  # pressure > 0
    incidence_cosine: Floats  # of the angle between the camera's ray and the membrane's normal


_presses = SampleCache(BubblePress, exact=("indentation_mm",), max_bytes=1 << 29)


def simulate_bubble_press(split: DataSplit, seed: int, index: int, folder: str = "") -> BubblePress:
    """Press `index` of a seed, the same on every call."""
    in_training = split == "training"
    rng = np.random.default_rng([VERSION, DATA_SPLITS.index(split), seed, index])
    nominal = not in_training or rng.random() < _NOMINAL_SHARE
    geometry = 0 if nominal else int(rng.integers(1, _N_GEOMETRIES + 1))
    sensor = variation.vary_sensor(_make_bubble(geometry), int(rng.integers(1 << 31)), 1.0)

    def make() -> BubblePress:
        _, mesh = sample_object(split, rng, index, catalogue_share=_CATALOGUE_SHARE)
        return _simulate_press(mesh, rng, sensor, as_recorded=not in_training)

    return _presses.get(f"bubble_{split}_{seed}_{index}", folder, make, sensor=sensor)


@lru_cache(maxsize=_N_GEOMETRIES + 1)
def _make_bubble(geometry: int) -> SensorSpec:
    """The nominal bubble (0), or one of another size, height and focal length."""
    nominal = load_sensor("soft_bubble")
    assert nominal.bubble is not None
    if not geometry:
        return nominal
    rng = np.random.default_rng([VERSION, geometry])
    width, height, rise, focal = rng.uniform((0.75, 0.75, 0.7, 0.75), (1.05, 1.1, 1.15, 1.3))
    shape: Bubble = replace(
        nominal.bubble, half_width_mm=width * nominal.bubble.half_width_mm,
        half_height_mm=height * nominal.bubble.half_height_mm, height_mm=rise * nominal.bubble.height_mm,
    )  # fmt: skip
    surface = membrane.make_dome_membrane(
        80.0 - shape.height_mm, shape.height_mm, shape.half_width_mm, shape.half_height_mm
    )
    camera = replace(nominal.camera, fx_px=focal * nominal.camera.fx_px, fy_px=focal * nominal.camera.fy_px)
    return replace(nominal, bubble=shape, membrane=surface, camera=camera, rest_depth_mm=surface.rest_depth_mm(camera))


def _simulate_press(mesh: Mesh, rng: np.random.Generator, sensor: SensorSpec, *, as_recorded: bool) -> BubblePress:
    if as_recorded or rng.random() < _AS_RECORDED_SHARE:
        deeper, pose = BUBBLE_DEEPER_MM, poses.sample_press_pose(mesh, rng)
    else:
        deeper = rng.uniform(-4.0, BUBBLE_DEEPER_MM + 2.0)
        pose = poses.sample_press_pose(mesh, rng, spread_mm=30.0, angle_deg=180.0, tilt_deg=12.0)
    press = simulate_press(mesh, pose, move_bubble_closer(sensor, deeper), seed=None)
    vertices = rigid.apply(press.sensor_from_object, mesh.vertices_mm)
    surface = lattice.render_mesh_depth(vertices, mesh.triangles, sensor.camera)
    depth = sensor.rest_depth_mm - press.indentation_mm
    gap = np.nan_to_num(np.maximum(surface - depth, 0.0), nan=MAX_GAP_MM)
    return BubblePress(
        sensor=sensor, indentation_mm=press.indentation_mm, contact=press.contact,
        gap_mm=np.minimum(gap, MAX_GAP_MM).astype(np.float32),
        incidence_cosine=bubble_camera.compute_incidence_cosine(sensor.camera, depth).astype(np.float32),
    )  # fmt: skip
