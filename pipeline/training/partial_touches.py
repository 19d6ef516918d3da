"""What is left of a bubble's touch where only a part of the object is told: a gel's window, a slice of its surface.

A pose network that has seen whole touches alone reads a translated one, whose body ends where the source's view does,
as a smaller object elsewhere. No source is simulated, and nothing that a network generated is seen: what is told is
drawn (`told`), and the bubble's own physics answers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from pipeline.base.arrays import Doubles, Floats, freeze
from pipeline.base.memo import Memo
from pipeline.geometry import rigid
from pipeline.networks.square_images import resize_to_square
from pipeline.physics import lattice
from pipeline.sensors.spec import SensorSpec
from pipeline.simulation import shapes
from pipeline.stages.touch.depth_condition import make_working_sensor
from pipeline.stages.touch.physical_render import PhysicalRenderParams, render_touch
from pipeline.training.source_observation import simulate_source_observation
from pipeline.training.target_touches import load_arrays, make_target_depth, save_arrays
from pipeline.training.touch_squares import PairedDataSplit, load_nominal_sensors, simulate_touch_squares

VERSION = 1  # counts up when the same number would give another part
_TOLERANCE_UM = 20.0  # of the physical render: its square is coarser than that
_MOST_BYTES = 1 << 29  # of parts that a worker remembers


@dataclass(frozen=True, slots=True, kw_only=True)
class PartialTouch:
    """A part of a touch."""

    imprint_mm: Floats  # (1, side, side); 0 everywhere where nothing of the object was told


def simulate_partial_touch(things: PairedDataSplit, seed: int, index: int, folder: str = "") -> PartialTouch:
    """A part of that paired touch, of an object of the catalogue: the same each time. `folder` keeps it."""
    return _in_memory.get_or_make((things, seed, index), lambda: _kept_or_made(things, seed, index, folder))


def _kept_or_made(things: PairedDataSplit, seed: int, index: int, folder: str) -> PartialTouch:
    path = Path(folder) / f"part_{things}_{seed}_{index}.npz" if folder else None
    found = None if path is None else load_arrays(path, PartialTouch)
    if found is None:
        rng = np.random.default_rng([VERSION, 19, seed, index, 0, *things.encode()])  # the first of all its parts
        touch = simulate_touch_squares(things, seed, index, folder)
        imprint = resize_to_square(_told_alone(touch.object_name, touch.alignment_from_object, rng)[..., None])
        found = PartialTouch(imprint_mm=freeze(imprint.astype(np.float16).astype(np.float32)))
        if path is not None:
            save_arrays(path, found)
    return found


def _told_alone(thing: str, alignment_from_object: Doubles, rng: np.random.Generator) -> Floats:
    """The imprint (rows, cols) of what a gel would tell of an object, on the working grid."""
    bubble, mesh = _bubble(), shapes.make_shape(thing).mesh
    sensor_from_object = rigid.invert(bubble.alignment_from_sensor) @ alignment_from_object
    surface = lattice.render_mesh_depth(
        rigid.apply(sensor_from_object, mesh.vertices_mm), mesh.triangles, bubble.camera
    )
    view = make_target_depth(bubble, simulate_source_observation(rng, surface, bubble, gel_share=1.0))
    membrane = render_touch(view, bubble, PhysicalRenderParams(tolerance_um=_TOLERANCE_UM)).membrane
    assert membrane is not None
    return membrane.indentation_mm


@lru_cache(maxsize=1)
def _bubble() -> SensorSpec:
    return make_working_sensor(load_nominal_sensors()[1])


_in_memory: Memo[tuple[PairedDataSplit, int, int], PartialTouch] = Memo(most_bytes=_MOST_BYTES)
