"""One touch felt by a GelSlim and by a bubble, both pictured, to learn one from the other and where the object is.

Units differ from press to press as those of a lab do, readings have their cameras' noise; what a gel felt is pictured
by the described unit as well, which is the one that touches are generated for. A press depends on a number alone and
takes a sixth of a second, so that it is kept where a folder is given.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, Floats, freeze
from pipeline.base.errors import SettingProblem
from pipeline.base.files import kept_arrays, whole_file
from pipeline.geometry import rigid
from pipeline.geometry.meshes import Mesh
from pipeline.networks.squares import change, square
from pipeline.sensors.spec import SensorSpec, sensor
from pipeline.simulation import poses, shapes, variation
from pipeline.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.simulation.press import photograph, press
from pipeline.simulation.random_bodies import body

VERSION = 3  # counts up when the same number would give another touch
Things = Literal["learned", "unseen_grasps", "unseen_tools", "own"]
_KINDS: tuple[Things, ...] = ("learned", "unseen_grasps", "unseen_tools", "own")
_CATALOGUE = 0.6  # share of training objects among what is learned; the others are random bodies
_STEPS = 2.0 * 255.0  # of a kept picture: half a grey
_COARSER = 3  # times a picture's pixels that a gel's contact is worked out at: still finer than a square's
_KEYS = ("gel", "own", "bubble", "exact", "pose", "thing")  # of a kept touch
_MOST_KEPT = 4096  # touches in a worker's memory, a quarter of a megabyte each
_MOST_EMPTY = 100  # presses in a row that one of the two does not feel


@dataclass(frozen=True, slots=True, kw_only=True)
class PairedTouch:
    """Both readings of a press as squares, and what was pressed where."""

    gel: Floats  # (3, side, side) change of the picture, in shares of full brightness
    own_gel: Floats  # (3, side, side) the same surface as the described unit pictures it
    bubble_mm: Floats  # (1, side, side) imprint as the depth camera gives it
    exact_mm: Floats  # (1, side, side) the imprint itself
    alignment_from_object: Doubles  # (4, 4) mm
    thing: str  # a name of the catalogue; "" = a body of its own


def paired_touch(things: Things, seed: int, index: int, folder: str = "") -> PairedTouch:
    """Touch `index` of a seed, or the next one that both sensors feel: the same each time.

    `own` are training objects and unseen tools alike, for what looks at one sensor's touches alone.
    """
    for number in range(index, index + _MOST_EMPTY):
        path = Path(folder) / f"{things}_{seed}_{number}.npz" if folder else None
        found = None if path is None else _kept(path)
        if found is None:
            found = _pressed(things, seed, number)
            if path is not None:
                _keep(path, found)
        if found.exact_mm.any() and found.gel.any():
            return found
    raise SettingProblem(f"none of {_MOST_EMPTY} presses from {index} on is felt; choose another seed")


def _pressed(things: Things, seed: int, number: int) -> PairedTouch:
    rng = np.random.default_rng([VERSION, 3, _KINDS.index(things), seed, number])
    name, thing = _thing(things, rng, number)
    pose = poses.single(thing, rng)
    units = [variation.varied(unit, int(rng.integers(1 << 31)), 1.0) for unit in described()]
    own, felt = described()[0], True
    squares: list[Floats] = []
    for unit in units:
        seeds = [int(s) for s in rng.integers(1 << 31, size=2)]
        looked_at = unit if unit.kind == "bubble" else unit.seen_through(unit.camera.scaled(1.0 / _COARSER))
        truth = press(thing, pose, looked_at, seed=None)
        moved, contact = truth.truth.indentation_mm, truth.truth.contact
        assert moved is not None
        assert contact is not None
        felt &= truth.converged and bool(contact.any())
        moved = _sized(moved, unit.camera.shape)
        for pictured in (unit, own) if unit.kind == "gel" else (unit,):
            image = photograph(pictured, moved, pictured.rest_depth_mm - moved, seeds[0])
            untouched = photograph(pictured, np.zeros_like(moved), pictured.rest_depth_mm, seeds[1])
            squares.append(square(change(pictured.kind, image, untouched)))
        if unit.kind == "bubble":
            squares.append(square(moved[..., None]))
    if not felt:
        squares = [np.zeros_like(s) for s in squares]
    return PairedTouch(
        gel=_as_kept(squares[0]), own_gel=_as_kept(squares[1]), bubble_mm=_halved(squares[2]),
        exact_mm=_halved(squares[3]), alignment_from_object=freeze(pose), thing=name,
    )  # fmt: skip


def _sized(field: Floats, shape: tuple[int, int]) -> Floats:
    import cv2

    if field.shape == shape:
        return field
    return np.asarray(cv2.resize(field, shape[::-1], interpolation=cv2.INTER_CUBIC), np.float32)


@lru_cache(maxsize=1)
def described() -> tuple[SensorSpec, SensorSpec]:
    """The gel, and the bubble that comes to meet the object as in data sets."""
    bubble = sensor("soft_bubble")
    nearer = rigid.translation(0.0, 0.0, BUBBLE_DEEPER_MM) @ bubble.alignment_from_sensor
    return sensor("gelslim"), replace(bubble, alignment_from_sensor=freeze(nearer))


def _thing(things: Things, rng: np.random.Generator, number: int) -> tuple[str, Mesh]:
    if things == "learned" and rng.random() >= _CATALOGUE:
        return "", body(rng)
    names = {
        "learned": shapes.names("training"), "unseen_grasps": shapes.names("training"),
        "unseen_tools": shapes.names("unseen"), "own": shapes.taught(),
    }[things]  # fmt: skip
    name = names[int(rng.integers(len(names))) if things == "learned" else number % len(names)]
    return name, shapes.shape(name).mesh


def _as_kept(a: Floats) -> Floats:
    """As a file gives it back: kept or not, a touch is the same."""
    return _seen(_steps(a))


def _steps(a: Floats) -> NDArray[Any]:
    return np.rint(a * np.float32(_STEPS)).astype(np.int16)


def _seen(steps: NDArray[Any]) -> Floats:
    return freeze((steps / np.float32(_STEPS)).astype(np.float32))


def _halved(a: Floats) -> Floats:
    return freeze(a.astype(np.float16).astype(np.float32))


def _keep(path: Path, found: PairedTouch) -> None:
    content = io.BytesIO()
    np.savez_compressed(
        content, gel=_steps(found.gel), own=_steps(found.own_gel), bubble=found.bubble_mm.astype(np.float16),
        exact=found.exact_mm.astype(np.float16), pose=found.alignment_from_object, thing=np.array(found.thing),
    )  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path, "a touch to learn from") as file:
        file.write(content.getbuffer())


def _kept(path: Path) -> PairedTouch | None:
    try:
        gel, own, bubble, exact, pose, thing = _packed(path)
    except FileNotFoundError:
        return None  # not there yet, or damaged: it is pressed again
    return PairedTouch(
        gel=_seen(gel), own_gel=_seen(own), bubble_mm=freeze(bubble.astype(np.float32)),
        exact_mm=freeze(exact.astype(np.float32)), alignment_from_object=freeze(pose), thing=str(thing),
    )  # fmt: skip


@lru_cache(maxsize=_MOST_KEPT)
def _packed(path: Path) -> tuple[NDArray[Any], ...]:
    """The arrays of a file, kept small in memory: every touch is drawn many times. Raises FileNotFoundError."""
    kept = kept_arrays(path)
    if kept is None or not set(_KEYS) <= set(kept):
        raise FileNotFoundError(path)
    return tuple(kept[key] for key in _KEYS)
