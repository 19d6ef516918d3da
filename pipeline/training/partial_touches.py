"""Touches of a bubble where only part of the object is observed: a gel's window, a slice of its surface.

A pose network trained on whole touches alone reads a translated touch, which ends where the source's view ends, as a
smaller object elsewhere. No source is simulated and no generated touch is used: the observation is sampled
(`source_observation`) and the bubble's physics renders it.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.geometry import rigid
from pipeline.networks.square_images import resize_to_square
from pipeline.physics import lattice
from pipeline.sensors.spec import SensorSpec
from pipeline.simulation import shapes
from pipeline.stages.touch.depth_condition import make_working_sensor
from pipeline.stages.touch.physical_render import PhysicalRenderParams, render_touch
from pipeline.training.object_sampling import DATA_SPLITS, DataSplit
from pipeline.training.sample_cache import SampleCache
from pipeline.training.source_observation import simulate_source_observation
from pipeline.training.target_touches import make_target_depth
from pipeline.training.touch_squares import load_nominal_sensors, simulate_touch_squares

VERSION = 2  # part of the seeds: incremented when the same number gives another part
_TOLERANCE_UM = 20.0  # of the physical render: a square's pixels are coarser


@dataclass(frozen=True, slots=True, kw_only=True)
class PartialTouch:
    """The imprint of the observed part of a touch."""

    imprint_mm: Floats  # (1, side, side); 0 where nothing of the object is observed


_parts = SampleCache(PartialTouch, max_bytes=1 << 29)


def simulate_partial_touch(split: DataSplit, seed: int, index: int, folder: str = "") -> PartialTouch:
    """A part of that touch of `touch_squares`, whose object must be of the catalogue; the same on every call."""
    return _parts.get(f"part_{split}_{seed}_{index}", folder, lambda: _simulate_part(split, seed, index, folder))


def _simulate_part(split: DataSplit, seed: int, index: int, folder: str) -> PartialTouch:
    rng = np.random.default_rng([VERSION, 19, DATA_SPLITS.index(split), seed, index])
    touch = simulate_touch_squares(split, seed, index, folder)
    bubble, mesh = _load_working_bubble(), shapes.make_shape(touch.object_name).mesh
    vertices = rigid.apply(rigid.invert(bubble.alignment_from_sensor) @ touch.alignment_from_object, mesh.vertices_mm)
    surface = lattice.render_mesh_depth(vertices, mesh.triangles, bubble.camera)
    view = make_target_depth(bubble, simulate_source_observation(rng, surface, bubble, gel_share=1.0))
    membrane = render_touch(view, bubble, PhysicalRenderParams(tolerance_um=_TOLERANCE_UM)).membrane
    assert membrane is not None
    return PartialTouch(imprint_mm=resize_to_square(membrane.indentation_mm[..., None]))


@lru_cache(maxsize=1)
def _load_working_bubble() -> SensorSpec:
    return make_working_sensor(load_nominal_sensors()[1])
