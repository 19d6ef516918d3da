"""One touch felt by a gel and by a bubble: what touch to touch learns from. Kept by number as `own_touches` are.

The bubble is seen by a camera as wide to every side of its axis, so that a pair can be mirrored (`mirrored`), which is
the pair that the mirrored object would give. The gel's picture is then taken anew, by another unit: its light knows
left and right.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.base.memo import Memo
from pipeline.geometry.camera import Camera
from pipeline.physics import optics
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.simulation import poses, variation
from pipeline.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.simulation.press import simulate_press
from pipeline.stages.touch.depth_condition import make_working_sensor
from pipeline.training.target_touches import (
    DATA_SPLITS,
    DataSplit,
    load_arrays,
    move_bubble_closer,
    sample_object_mesh,
    save_arrays,
)

VERSION = 3  # counts up when the same number would give another pair
GEL, BUBBLE = "gelslim", "soft_bubble"
_AS_RECORDED, _DEEPER_MM = 0.5, (0.0, 11.0)
_MOST_BYTES = 1 << 30  # of pairs that a worker remembers


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchPair:
    """Both sides of a touch on their working grids."""

    change_grey: Floats  # (rows, cols, 3) of the gel's picture, with its noise
    gel_mm: Floats
    gel_contact: Mask
    symmetric_bubble_mm: Floats  # the bubble as `symmetric` sees it, without noise
    symmetric_bubble_contact: Mask
    deeper_mm: Floats  # (1,) how much farther the bubble came to meet the object than described

    @property
    def bubble_mm(self) -> Floats:
        """As the bubble's own camera sees it."""
        return self.symmetric_bubble_mm[_seen()]

    @property
    def bubble_contact(self) -> Mask:
        """As the bubble's own camera sees it."""
        return self.symmetric_bubble_contact[_seen()]


def place_nominal_sensors(deeper_mm: float) -> tuple[SensorSpec, SensorSpec]:
    """Gel and bubble as described, on their working grids and as they stood."""
    gel, bubble = _described()
    return gel, move_bubble_closer(bubble, deeper_mm)


def simulate_touch_pair(things: DataSplit, seed: int, index: int, folder: str = "") -> TouchPair | None:
    """Pair `index` of a seed: the same each time; None where the gel feels nothing. `folder` keeps it."""
    found = _in_memory.get_or_make((things, seed, index), lambda: _kept_or_made(things, seed, index, folder))
    return found if found.gel_contact.any() else None


def _kept_or_made(things: DataSplit, seed: int, index: int, folder: str) -> TouchPair:
    path = Path(folder) / f"pair_{things}_{seed}_{index}.npz" if folder else None
    found = None if path is None else load_arrays(path, TouchPair)
    if found is None:
        rng = np.random.default_rng([VERSION, 13, DATA_SPLITS.index(things), seed, index])
        found = _simulate_pair(things, rng, index)
        if path is not None:
            save_arrays(path, found)
    return found


def _simulate_pair(things: DataSplit, rng: np.random.Generator, index: int) -> TouchPair:
    usual = things != "learned" or rng.random() < _AS_RECORDED
    deeper = BUBBLE_DEEPER_MM if usual else rng.uniform(*_DEEPER_MM)
    gel, bubble = (
        variation.vary_sensor(unit, int(rng.integers(1 << 31)), 1.0) for unit in place_nominal_sensors(deeper)
    )
    bubble = bubble.with_camera(make_symmetric_camera(bubble.camera))
    thing = sample_object_mesh(things, rng, index)
    pose = poses.sample_press_pose(thing, rng)
    below = simulate_press(thing, pose, gel, seed=int(rng.integers(1 << 31)))
    above = simulate_press(thing, pose, bubble, seed=None).truth
    under = below.truth
    assert under.indentation_mm is not None
    assert under.contact is not None
    assert above.indentation_mm is not None
    assert above.contact is not None
    change = below.image.astype(np.float32) - optics.render_reference(gel).astype(np.float32)
    return TouchPair(
        change_grey=_as_kept(change), gel_mm=_as_kept(under.indentation_mm), gel_contact=under.contact,
        symmetric_bubble_mm=_as_kept(above.indentation_mm), symmetric_bubble_contact=above.contact,
        deeper_mm=_as_kept(np.array([deeper], np.float32)),
    )  # fmt: skip


def mirror_pair(pair: TouchPair, rng: np.random.Generator) -> TouchPair:
    """The pair of the object mirrored across x, across y or both, or as it was; pictured by a unit of its own."""
    way = int(rng.integers(4))
    axes = tuple(axis for axis, flips in ((-1, way & 1), (-2, way & 2)) if flips)

    def flip_field(field: NDArray[Any]) -> Any:
        return freeze(np.ascontiguousarray(np.flip(field, axes)))

    gel_mm = flip_field(pair.gel_mm)
    gel = variation.vary_sensor(_described()[0], int(rng.integers(1 << 31)), 1.0)
    picture = optics.render(gel, gel_mm, seed=int(rng.integers(1 << 31)))
    change = picture.astype(np.float32) - optics.render_reference(gel).astype(np.float32)
    return replace(
        pair, change_grey=freeze(change), gel_mm=gel_mm, gel_contact=flip_field(pair.gel_contact),
        symmetric_bubble_mm=flip_field(pair.symmetric_bubble_mm), symmetric_bubble_contact=flip_field(pair.symmetric_bubble_contact),
    )  # fmt: skip


def make_symmetric_camera(camera: Camera) -> Camera:
    """The least camera with all of this one's pixels that looks straight at its own middle, or half a pixel beside."""
    (before_x, cols), (before_y, rows) = _sides(camera.cx_px, camera.cols), _sides(camera.cy_px, camera.rows)
    return replace(
        camera, rows=rows, cols=cols, cx_px=camera.cx_px + before_x, cy_px=camera.cy_px + before_y,
    )  # fmt: skip


def _sides(centre_px: float, n: int) -> tuple[int, int]:
    """How many pixels to add before the first of `n`, and how many there are then."""
    more = round(n - 1 - 2 * centre_px)  # behind the centre than before it
    return max(more, 0), n + abs(more)


@lru_cache(maxsize=1)
def _seen() -> tuple[slice, slice]:
    """The pixels of the bubble's own camera in the symmetric one."""
    camera = _described()[1].camera
    x, y = _sides(camera.cx_px, camera.cols)[0], _sides(camera.cy_px, camera.rows)[0]
    return slice(y, y + camera.rows), slice(x, x + camera.cols)


_in_memory: Memo[tuple[DataSplit, int, int], TouchPair] = Memo(most_bytes=_MOST_BYTES)


@lru_cache(maxsize=1)
def _described() -> tuple[SensorSpec, SensorSpec]:
    return make_working_sensor(load_sensor(GEL)), make_working_sensor(load_sensor(BUBBLE))


def _as_kept(a: Floats) -> Floats:
    return freeze(a.astype(np.float16).astype(np.float32))
