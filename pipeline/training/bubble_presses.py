"""Presses of bubbles to learn from: objects of the catalogue and random bodies on units that differ, and their noise.

The contact is the dear part and depends on a number alone, so that it is worked out once and kept where a folder is
given; what a depth camera makes of it is drawn anew each time.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Mask, freeze
from pipeline.base.files import open_atomic, read_cached_arrays
from pipeline.geometry import membrane, rigid
from pipeline.geometry.meshes import Mesh
from pipeline.physics import bubble_camera, lattice
from pipeline.sensors.parts import Bubble
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.simulation import poses, shapes, variation
from pipeline.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.simulation.press import simulate_press
from pipeline.simulation.random_bodies import make_random_body

VERSION = 2  # counts up when the same number would give another press
MAX_GAP_MM = 8.0  # gaps are kept up to this; beyond it nothing tells how far the object is

DataSplit = Literal["learned", "unseen_grasps", "unseen_tools"]
_GEOMETRIES = 12  # bubbles of other shapes and cameras, beside the described one
_DESCRIBED, _CATALOGUE, _AS_RECORDED = 0.6, 0.33, 0.6  # shares: units as described, training objects, poses as recorded


@dataclass(frozen=True, slots=True, kw_only=True)
class BubblePress:
    """A bubble under an object, exactly."""

    sensor: SensorSpec  # the unit
    indentation_mm: Floats  # (rows, cols) rest - depth of the membrane
    gap_mm: Floats  # (rows, cols) from the membrane to the object behind it along z, >= 0, at most MAX_TRANSLATION_MM
    contact: Mask  # (rows, cols) pressure > 0
    incidence_cosine: Floats  # (rows, cols) of the angle at which the camera looks at the membrane


def simulate_bubble_press(things: DataSplit, seed: int, index: int, folder: str = "") -> BubblePress:
    """Press `index` of a seed: the same each time. `folder` keeps it for the next time; "" keeps nothing."""
    rng = np.random.default_rng([VERSION, ("learned", "unseen_grasps", "unseen_tools").index(things), seed, index])
    unit = _unit(rng, described=things != "learned" or rng.random() < _DESCRIBED)
    path = Path(folder) / f"{things}_{seed}_{index}.npz" if folder else None
    found = None if path is None else _kept(path, unit)
    if found is None:
        found = _press(_thing(things, rng, index), rng, unit, as_recorded=things != "learned")
        if path is not None:
            _keep(path, found)
    return found


def _unit(rng: np.random.Generator, *, described: bool) -> SensorSpec:
    geometry = 0 if described else int(rng.integers(1, _GEOMETRIES + 1))
    return variation.vary_sensor(_bubble(geometry), int(rng.integers(1 << 31)), 1.0)


@lru_cache(maxsize=_GEOMETRIES + 1)
def _bubble(geometry: int) -> SensorSpec:
    """The described bubble, or another one: as wide and high as they come, seen by a finer or a coarser camera."""
    like = load_sensor("soft_bubble")
    assert like.bubble is not None
    if not geometry:
        return like
    rng = np.random.default_rng([VERSION, geometry])
    wide, high, flat, near = rng.uniform((0.75, 0.75, 0.7, 0.75), (1.05, 1.1, 1.15, 1.3))
    shape: Bubble = replace(
        like.bubble, half_width_mm=wide * like.bubble.half_width_mm, half_height_mm=high * like.bubble.half_height_mm,
        height_mm=flat * like.bubble.height_mm,
    )  # fmt: skip
    surface = membrane.make_dome_membrane(
        80.0 - shape.height_mm, shape.height_mm, shape.half_width_mm, shape.half_height_mm
    )
    eye = replace(like.camera, fx_px=near * like.camera.fx_px, fy_px=near * like.camera.fy_px)
    return replace(
        like, bubble=shape, membrane=surface, camera=eye, rest_depth_mm=surface.rest_depth_mm(eye),
    )  # fmt: skip


def _thing(things: DataSplit, rng: np.random.Generator, index: int) -> Mesh:
    if things == "learned":
        names = shapes.list_shapes("training")
        return (
            shapes.make_shape(names[int(rng.integers(len(names)))]).mesh
            if rng.random() < _CATALOGUE
            else make_random_body(rng)
        )
    names = shapes.list_shapes("training" if things == "unseen_grasps" else "unseen")
    return shapes.make_shape(names[index % len(names)]).mesh


def _press(thing: Mesh, rng: np.random.Generator, unit: SensorSpec, *, as_recorded: bool) -> BubblePress:
    if as_recorded or rng.random() < _AS_RECORDED:
        deeper, pose = BUBBLE_DEEPER_MM, poses.sample_press_pose(thing, rng)
    else:
        deeper = rng.uniform(-4.0, BUBBLE_DEEPER_MM + 2.0)
        pose = poses.sample_press_pose(thing, rng, spread_mm=30.0, angle_deg=180.0, tilt_deg=12.0)
    stands: Doubles = freeze(rigid.translation(0.0, 0.0, deeper) @ unit.alignment_from_sensor)
    placed = replace(unit, alignment_from_sensor=stands)
    felt = simulate_press(thing, pose, placed, seed=None)
    from_object = felt.truth.sensor_from_object
    assert felt.truth.indentation_mm is not None
    assert felt.truth.contact is not None
    assert from_object is not None
    surface = lattice.render_mesh_depth(rigid.apply(from_object, thing.vertices_mm), thing.triangles, unit.camera)
    depth = unit.rest_depth_mm - felt.truth.indentation_mm
    gap = np.nan_to_num(np.maximum(surface - depth, 0.0), nan=MAX_GAP_MM)
    return BubblePress(
        sensor=unit, indentation_mm=felt.truth.indentation_mm, contact=felt.truth.contact,
        gap_mm=freeze(_as_kept(np.minimum(gap, MAX_GAP_MM))),
        incidence_cosine=freeze(_as_kept(bubble_camera.compute_incidence_cosine(unit.camera, depth))),
    )  # fmt: skip


def _as_kept(a: Doubles) -> Floats:
    """As a file gives it back: kept or not, a press is the same."""
    return a.astype(np.float16).astype(np.float32)


def _keep(path: Path, found: BubblePress) -> None:
    content = io.BytesIO()
    np.savez(content, moved=found.indentation_mm, contact=found.contact,
             gap=found.gap_mm.astype(np.float16), cosine=found.incidence_cosine.astype(np.float16))  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    with open_atomic(path, "a press to learn from") as file:
        file.write(content.getbuffer())


def _kept(path: Path, unit: SensorSpec) -> BubblePress | None:
    kept = read_cached_arrays(path)
    if kept is None or not {"moved", "gap", "contact", "cosine"} <= set(kept):
        return None  # not there yet, or damaged: it is worked out again
    moved, gap, contact, cosine = (kept[key] for key in ("moved", "gap", "contact", "cosine"))
    return BubblePress(
        sensor=unit, indentation_mm=freeze(moved), contact=freeze(contact),
        gap_mm=freeze(gap.astype(np.float32)), incidence_cosine=freeze(cosine.astype(np.float32)),
    )  # fmt: skip
