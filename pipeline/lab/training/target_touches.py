"""Touches of one sensor alone, for touch to depth to touch: no pair is simulated.

The target is pressed onto an object. What a source could observe of that object is sampled
(`source_observation`), and the physical render of that observation is the answer that a network has
to improve on.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import Floats, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.core.geometry import rigid
from pipeline.core.geometry.rasterisation import render_mesh
from pipeline.core.values.results import TargetDepth, make_pixel_index
from pipeline.lab.training.object_sampling import DATA_SPLITS, DataSplit, SampleCache, sample_object
from pipeline.lab.training.source_observation import SourceObservation, simulate_source_observation
from pipeline.physics.simulation import poses, variation
from pipeline.physics.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.physics.simulation.press import move_bubble_closer, simulate_press
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.touch.physical_render import PhysicalRenderParams, render_touch
from pipeline.stages.touch.t2d2 import make_working_sensor

VERSION = 3  # part of the seeds: incremented when the same number gives another touch
# of all objects; of the random bodies
CATALOGUE_SHARE = 0.4
SMALL_SHARE = 0.6
# of the deepest point over a gel; data sets begin at 0.3 mm, other recordings lower
TRAINING_DEPTH_MM = (0.15, 1.0)
DEEPER_MM = (0.0, 11.0)  # range of a bubble's approach where it is not that of the data sets
_TOLERANCE_UM = 5.0  # of the physical render: residuals are tenths of a millimetre
_AS_RECORDED_SHARE = 0.6  # bubbles that come as close as in the data sets
# gels among the sampled sources, by the kind of the target
_GEL_SHARE = {"gel": 0.45, "bubble": 0.95}


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetTouchSample:
    """A touch as observed, as rendered by physics, and as recorded.

    Arrays (rows, cols) on the working grid.
    """

    observed_mm: Floats  # indentation of the object where the source observes it, 0 elsewhere
    observed: Mask
    in_view: Mask
    physical_mm: Floats  # indentation of the physical render
    physical_contact: Mask
    target_mm: Floats  # indentation that the target records
    target_contact: Mask


_samples = SampleCache(TargetTouchSample)


def simulate_target_touch(
    target: str, split: DataSplit, seed: int, index: int, folder: str = ""
) -> TargetTouchSample | None:
    """Touch `index` of a seed, the same on every call; None where the source observes nothing."""
    sample = _samples.get(
        f"target_{target}_{split}_{seed}_{index}",
        folder,
        lambda: _simulate_sample(target, split, seed, index),
    )
    return sample if sample.observed.any() else None


def _simulate_sample(target: str, split: DataSplit, seed: int, index: int) -> TargetTouchSample:
    rng = np.random.default_rng([VERSION, 11, DATA_SPLITS.index(split), seed, index])
    nominal = _load_working_sensor(target)
    instance = _vary_instance(nominal, split, rng)
    _, mesh = sample_object(
        split, rng, index, catalogue_share=CATALOGUE_SHARE, small_share=SMALL_SHARE
    )
    depth_mm = TRAINING_DEPTH_MM if split == "training" else poses.DEPTH_RANGE_MM
    press = simulate_press(
        mesh, poses.sample_press_pose(mesh, rng, depth_mm=depth_mm), instance, seed=None
    )
    vertices = rigid.apply(press.sensor_from_object, mesh.vertices_mm)
    surface = render_mesh(vertices, mesh.triangles, instance.camera)[0]
    observation = simulate_source_observation(
        rng, surface, nominal, gel_share=_GEL_SHARE[nominal.kind]
    )
    view = make_target_depth(nominal, observation)
    rendered = render_touch(
        view, nominal, PhysicalRenderParams(tolerance_um=_TOLERANCE_UM)
    ).membrane
    assert rendered is not None
    return TargetTouchSample(
        observed_mm=np.where(view.contact, view.indentation_mm, np.float32(0.0)),
        observed=view.contact,
        in_view=view.in_view,
        physical_mm=rendered.indentation_mm,
        physical_contact=rendered.contact,
        target_mm=press.indentation_mm,
        target_contact=press.contact,
    )


def make_target_depth(target: SensorSpec, observation: SourceObservation) -> TargetDepth:
    """The observation as projection hands it on: contact where the surface lies beyond the
    target's rest surface.
    """
    rest = target.rest_depth_mm
    with np.errstate(invalid="ignore"):
        contact = observation.observed & (observation.depth_mm <= rest)
    deep: Floats = np.where(contact, rest - observation.depth_mm, 0.0).astype(np.float32)
    index = np.where(observation.observed, make_pixel_index(rest.shape), np.int32(-1)).astype(
        np.int32
    )
    return TargetDepth(
        depth_mm=observation.depth_mm,
        contact=freeze(contact),
        indentation_mm=freeze(deep),
        camera=target.camera,
        source_index=freeze(index),
        in_view=observation.in_view,
    )


def _vary_instance(nominal: SensorSpec, split: DataSplit, rng: np.random.Generator) -> SensorSpec:
    """Another sensor instance; a bubble comes as close to the object as in the data sets, or
    nearly so.
    """
    instance = variation.vary_sensor(nominal, int(rng.integers(1 << 31)), 1.0)
    if instance.bubble is None:
        return instance
    as_recorded = split != "training" or rng.random() < _AS_RECORDED_SHARE
    return move_bubble_closer(
        instance, BUBBLE_DEEPER_MM if as_recorded else rng.uniform(*DEEPER_MM)
    )


@derive_once
def _load_working_sensor(name: str) -> SensorSpec:
    return make_working_sensor(load_sensor(name))
