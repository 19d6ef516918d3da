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
from pipeline.sensors.spec import SensorSpec, sensor
from pipeline.simulation import poses, variation
from pipeline.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.simulation.press import press
from pipeline.stages.generate.residual_input import working
from pipeline.training.own_touches import KINDS, Things, keep, nearer, read, thing_of

VERSION = 3  # counts up when the same number would give another pair
GEL, BUBBLE = "gelslim", "soft_bubble"
_AS_RECORDED, _DEEPER_MM = 0.5, (0.0, 11.0)
_MOST_BYTES = 1 << 30  # of pairs that a worker remembers


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Both sides of a touch on their working grids."""

    change_grey: Floats  # (rows, cols, 3) of the gel's picture, with its noise
    gel_mm: Floats
    gel_contact: Mask
    wide_mm: Floats  # the bubble as `symmetric` sees it, without noise
    wide_contact: Mask
    deeper_mm: Floats  # (1,) how much farther the bubble came to meet the object than described

    @property
    def bubble_mm(self) -> Floats:
        """As the bubble's own camera sees it."""
        return self.wide_mm[_seen()]

    @property
    def bubble_contact(self) -> Mask:
        """As the bubble's own camera sees it."""
        return self.wide_contact[_seen()]


def units(deeper_mm: float) -> tuple[SensorSpec, SensorSpec]:
    """Gel and bubble as described, on their working grids and as they stood."""
    gel, bubble = _described()
    return gel, nearer(bubble, deeper_mm)


def pair(things: Things, seed: int, index: int, folder: str = "") -> Pair | None:
    """Pair `index` of a seed: the same each time; None where the gel feels nothing. `folder` keeps it."""
    found = _in_memory.of((things, seed, index), lambda: _kept_or_made(things, seed, index, folder))
    return found if found.gel_contact.any() else None


def _kept_or_made(things: Things, seed: int, index: int, folder: str) -> Pair:
    path = Path(folder) / f"pair_{things}_{seed}_{index}.npz" if folder else None
    found = None if path is None else read(path, Pair)
    if found is None:
        rng = np.random.default_rng([VERSION, 13, KINDS.index(things), seed, index])
        found = _made(things, rng, index)
        if path is not None:
            keep(path, found)
    return found


def _made(things: Things, rng: np.random.Generator, index: int) -> Pair:
    usual = things != "learned" or rng.random() < _AS_RECORDED
    deeper = BUBBLE_DEEPER_MM if usual else rng.uniform(*_DEEPER_MM)
    gel, bubble = (variation.varied(unit, int(rng.integers(1 << 31)), 1.0) for unit in units(deeper))
    bubble = bubble.seen_through(symmetric(bubble.camera))
    thing = thing_of(things, rng, index)
    pose = poses.single(thing, rng)
    below = press(thing, pose, gel, seed=int(rng.integers(1 << 31)))
    above = press(thing, pose, bubble, seed=None).truth
    under = below.truth
    assert under.indentation_mm is not None
    assert under.contact is not None
    assert above.indentation_mm is not None
    assert above.contact is not None
    change = below.image.astype(np.float32) - optics.untouched(gel).astype(np.float32)
    return Pair(
        change_grey=_as_kept(change), gel_mm=_as_kept(under.indentation_mm), gel_contact=under.contact,
        wide_mm=_as_kept(above.indentation_mm), wide_contact=above.contact,
        deeper_mm=_as_kept(np.array([deeper], np.float32)),
    )  # fmt: skip


def mirrored(pair: Pair, rng: np.random.Generator) -> Pair:
    """The pair of the object mirrored across x, across y or both, or as it was; pictured by a unit of its own."""
    way = int(rng.integers(4))
    axes = tuple(axis for axis, flips in ((-1, way & 1), (-2, way & 2)) if flips)

    def over(field: NDArray[Any]) -> Any:
        return freeze(np.ascontiguousarray(np.flip(field, axes)))

    gel_mm = over(pair.gel_mm)
    gel = variation.varied(_described()[0], int(rng.integers(1 << 31)), 1.0)
    picture = optics.render(gel, gel_mm, seed=int(rng.integers(1 << 31)))
    change = picture.astype(np.float32) - optics.untouched(gel).astype(np.float32)
    return replace(
        pair, change_grey=freeze(change), gel_mm=gel_mm, gel_contact=over(pair.gel_contact),
        wide_mm=over(pair.wide_mm), wide_contact=over(pair.wide_contact),
    )  # fmt: skip


def symmetric(camera: Camera) -> Camera:
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


_in_memory: Memo[tuple[Things, int, int], Pair] = Memo(most_bytes=_MOST_BYTES)


@lru_cache(maxsize=1)
def _described() -> tuple[SensorSpec, SensorSpec]:
    return working(sensor(GEL)), working(sensor(BUBBLE))


def _as_kept(a: Floats) -> Floats:
    return freeze(a.astype(np.float16).astype(np.float32))
