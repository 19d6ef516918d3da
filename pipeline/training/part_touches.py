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
from pipeline.networks.squares import square
from pipeline.physics import lattice
from pipeline.sensors.spec import SensorSpec
from pipeline.simulation import shapes
from pipeline.stages.generate.residual_input import working
from pipeline.stages.generate.stage import GenerateParams, generate
from pipeline.training.own_touches import keep, read, view_of
from pipeline.training.paired_touches import Things, described, paired_touch
from pipeline.training.told import told

VERSION = 1  # counts up when the same number would give another part
_TOLERANCE_UM = 20.0  # of the physical render: its square is coarser than that
_MOST_BYTES = 1 << 29  # of parts that a worker remembers


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A part of a touch."""

    imprint_mm: Floats  # (1, side, side); 0 everywhere where nothing of the object was told


def part(things: Things, seed: int, index: int, folder: str = "") -> Part:
    """A part of that paired touch, of an object of the catalogue: the same each time. `folder` keeps it."""
    return _in_memory.of((things, seed, index), lambda: _kept_or_made(things, seed, index, folder))


def _kept_or_made(things: Things, seed: int, index: int, folder: str) -> Part:
    path = Path(folder) / f"part_{things}_{seed}_{index}.npz" if folder else None
    found = None if path is None else read(path, Part)
    if found is None:
        rng = np.random.default_rng([VERSION, 19, seed, index, 0, *things.encode()])  # the first of all its parts
        touch = paired_touch(things, seed, index, folder)
        imprint = square(_told_alone(touch.thing, touch.alignment_from_object, rng)[..., None])
        found = Part(imprint_mm=freeze(imprint.astype(np.float16).astype(np.float32)))
        if path is not None:
            keep(path, found)
    return found


def _told_alone(thing: str, alignment_from_object: Doubles, rng: np.random.Generator) -> Floats:
    """The imprint (rows, cols) of what a gel would tell of an object, on the working grid."""
    bubble, mesh = _bubble(), shapes.shape(thing).mesh
    sensor_from_object = rigid.invert(bubble.alignment_from_sensor) @ alignment_from_object
    surface = lattice.depth_of_mesh(rigid.apply(sensor_from_object, mesh.vertices_mm), mesh.triangles, bubble.camera)
    view = view_of(bubble, told(rng, surface, bubble, as_gel=1.0))
    membrane = generate(view, bubble, GenerateParams(tolerance_um=_TOLERANCE_UM)).membrane
    assert membrane is not None
    return membrane.indentation_mm


@lru_cache(maxsize=1)
def _bubble() -> SensorSpec:
    return working(described()[1])


_in_memory: Memo[tuple[Things, int, int], Part] = Memo(most_bytes=_MOST_BYTES)
