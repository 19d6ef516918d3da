"""Touches of one sensor alone, to learn what it feels beside what another could tell of the same object.

The target is pressed onto an object; what a source would tell of that object is drawn (`told`), and the physical render
of just that is the answer that a network has to better. No second sensor is pressed: nothing here is a pair. Worked out
once for each number and kept where a folder is given.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Mask, freeze
from pipeline.base.files import open_atomic, read_cached_arrays
from pipeline.base.memo import Memo
from pipeline.geometry import rigid
from pipeline.geometry.meshes import Mesh
from pipeline.physics import lattice
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.simulation import poses, shapes, variation
from pipeline.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.simulation.press import simulate_press
from pipeline.simulation.random_bodies import make_random_body
from pipeline.stages.touch.depth_condition import make_working_sensor
from pipeline.stages.touch.physical_render import PhysicalRenderParams, render_touch
from pipeline.training.source_observation import SourceObservation, simulate_source_observation
from pipeline.values.pixel_index import make_pixel_index
from pipeline.values.results import TargetDepth

T = TypeVar("T")
VERSION = 2  # counts up when the same number would give another touch
DataSplit = Literal["learned", "unseen_grasps", "unseen_tools"]
DATA_SPLITS: tuple[DataSplit, ...] = ("learned", "unseen_grasps", "unseen_tools")

_TOLERANCE_UM = 5.0  # of the physical render: what is learned is tenths of a millimetre
_CATALOGUE, _SMALL, _AS_RECORDED = 0.4, 0.6, 0.6  # shares: training objects; of the random ones those that are small
# and have nothing behind them; bubbles as in data sets
_SMALL_MM = 6.0, 17.0
_AS_GEL = {"gel": 0.45, "bubble": 0.95}  # of the sources that are drawn for a target
_DEEPER_MM = (0.0, 11.0)
_MOST_BYTES = 1 << 30  # of touches that a worker remembers: some two thousand


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetTouchSample:
    """A touch as it is told, as physics answers, and as it is; each (rows, cols) on the working grid."""

    observed_mm: Floats  # indentation of the object where it was felt, 0 elsewhere
    observed: Mask
    in_view: Mask
    physical_mm: Floats  # the physical render's indentation
    physical_contact: Mask
    target_mm: Floats  # the target's own
    target_contact: Mask


def simulate_target_touch(
    target: str, things: DataSplit, seed: int, index: int, folder: str = ""
) -> TargetTouchSample | None:
    """Touch `index` of a seed: the same each time; None where nothing is told. `folder` keeps it."""
    found = _in_memory.get_or_make(
        (target, things, seed, index), lambda: _kept_or_made(target, things, seed, index, folder)
    )
    return found if found.observed.any() else None


def _kept_or_made(target: str, things: DataSplit, seed: int, index: int, folder: str) -> TargetTouchSample:
    path = Path(folder) / f"own_{target}_{things}_{seed}_{index}.npz" if folder else None
    found = None if path is None else load_arrays(path, TargetTouchSample)
    if found is None:
        rng = np.random.default_rng([VERSION, 11, DATA_SPLITS.index(things), seed, index])
        found = _made(target, things, rng, index)
        if path is not None:
            save_arrays(path, found)
    return found


def _made(name: str, things: DataSplit, rng: np.random.Generator, index: int) -> TargetTouchSample:
    described = _working(name)
    unit, thing = vary_sensor_instance(described, things, rng), sample_object_mesh(things, rng, index)
    pose = poses.sample_press_pose(thing, rng)
    own = simulate_press(thing, pose, unit, seed=None).truth
    assert own.indentation_mm is not None
    assert own.contact is not None
    assert own.sensor_from_object is not None
    vertices = rigid.apply(own.sensor_from_object, thing.vertices_mm)
    surface = lattice.render_mesh_depth(vertices, thing.triangles, unit.camera)
    said = simulate_source_observation(rng, surface, described, gel_share=_AS_GEL[described.kind])
    return make_target_sample(described, make_target_depth(described, said), own.indentation_mm, own.contact)


def make_target_sample(described: SensorSpec, view: TargetDepth, truth_mm: Floats, contact: Mask) -> TargetTouchSample:
    """A view, its physical render and the target's own touch, as they are learned from."""
    rendered = render_touch(view, described, PhysicalRenderParams(tolerance_um=_TOLERANCE_UM)).membrane
    assert rendered is not None
    return TargetTouchSample(
        observed_mm=_as_kept(np.where(view.contact, view.indentation_mm, np.float32(0.0))), observed=view.contact,
        in_view=view.in_view, physical_mm=_as_kept(rendered.indentation_mm), physical_contact=rendered.contact,
        target_mm=_as_kept(truth_mm), target_contact=contact,
    )  # fmt: skip


def make_target_depth(target: SensorSpec, said: SourceObservation) -> TargetDepth:
    """As projection would hand it on: contact where the surface told lies beyond the target's rest surface."""
    rest = target.rest_depth_mm
    with np.errstate(invalid="ignore"):
        contact = said.observed & (said.depth_mm <= rest)
    deep: Floats = np.where(contact, rest - said.depth_mm, 0.0).astype(np.float32)
    index = np.where(said.observed, make_pixel_index(rest.shape), np.int32(-1)).astype(np.int32)
    return TargetDepth(
        depth_mm=said.depth_mm, contact=freeze(contact), indentation_mm=freeze(deep), camera=target.camera,
        source_index=freeze(index), in_view=said.in_view,
    )  # fmt: skip


def vary_sensor_instance(described: SensorSpec, things: DataSplit, rng: np.random.Generator) -> SensorSpec:
    """Another unit of a sensor; a bubble's comes as far to meet the object as in data sets, or nearly so."""
    unit = variation.vary_sensor(described, int(rng.integers(1 << 31)), 1.0)
    if unit.kind != "bubble":
        return unit
    usual = things != "learned" or rng.random() < _AS_RECORDED
    return move_bubble_closer(unit, BUBBLE_DEEPER_MM if usual else rng.uniform(*_DEEPER_MM))


def move_bubble_closer(bubble: SensorSpec, by_mm: float) -> SensorSpec:
    """A bubble that comes so much farther to meet the object than described."""
    moved: Doubles = freeze(rigid.translation(0.0, 0.0, by_mm) @ bubble.alignment_from_sensor)
    return replace(bubble, alignment_from_sensor=moved)


def sample_object_mesh(things: DataSplit, rng: np.random.Generator, index: int) -> Mesh:
    """An object to learn from: of the catalogue or random, with a body behind it or none; or one that is held out."""
    names = shapes.list_shapes("unseen" if things == "unseen_tools" else "training")
    if things != "learned":
        return shapes.make_shape(names[index % len(names)]).mesh
    if rng.random() < _CATALOGUE:
        return shapes.make_shape(names[int(rng.integers(len(names)))]).mesh
    return _small(rng) if rng.random() < _SMALL else make_random_body(rng)


def _small(rng: np.random.Generator) -> Mesh:
    """A random object that a gel feels nearly all of: nothing but the walls of a pattern, drawn smaller."""
    large = make_random_body(rng, unsupported_share=1.0)
    extent = float(np.ptp(large.vertices_mm[:, :2], axis=0).max())
    scale = min(1.0, rng.uniform(*_SMALL_MM) / extent)
    return replace(large, vertices_mm=freeze(large.vertices_mm * (scale, scale, 1.0)))


_in_memory: Memo[tuple[str, DataSplit, int, int], TargetTouchSample] = Memo(most_bytes=_MOST_BYTES)


@lru_cache(maxsize=4)
def _working(name: str) -> SensorSpec:
    return make_working_sensor(load_sensor(name))


def _as_kept(a: Floats) -> Floats:
    """As a file gives it back: kept or not, a touch is the same."""
    return freeze(a.astype(np.float16).astype(np.float32))


def save_arrays(path: Path, found: object) -> None:
    """Bring a dataclass of arrays to the disk, its floating-point ones as float16."""
    arrays = {f.name: getattr(found, f.name) for f in fields(cast("Any", found))}
    content = io.BytesIO()
    np.savez(content, **{k: a.astype(np.float16) if a.dtype == np.float32 else a for k, a in arrays.items()})
    path.parent.mkdir(parents=True, exist_ok=True)
    with open_atomic(path, "a touch to learn from") as file:
        file.write(content.getbuffer())


def load_arrays(path: Path, kind: type[T]) -> T | None:
    """What `keep` wrote; None where it is not there yet, or cut short: it is worked out again."""
    arrays = read_cached_arrays(path)
    if arrays is None or set(arrays) != {f.name for f in fields(cast("Any", kind))}:
        return None
    return kind(**{k: freeze(a.astype(np.float32) if a.dtype == np.float16 else a) for k, a in arrays.items()})
