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
from pipeline.base.files import open_atomic, read_cached_arrays
from pipeline.geometry import rigid
from pipeline.geometry.meshes import Mesh
from pipeline.networks.square_images import compute_change, resize_to_square
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.simulation import poses, shapes, variation
from pipeline.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.simulation.press import render_sensor_image, simulate_press
from pipeline.simulation.random_bodies import make_random_body

VERSION = 3  # counts up when the same number would give another touch
PairedDataSplit = Literal["learned", "unseen_grasps", "unseen_tools", "own"]
_KINDS: tuple[PairedDataSplit, ...] = ("learned", "unseen_grasps", "unseen_tools", "own")
_CATALOGUE = 0.6  # share of training objects among what is learned; the others are random bodies
_STEPS = 2.0 * 255.0  # of a kept picture: half a grey
_COARSER = 3  # times a picture's pixels that a gel's contact is worked out at: still finer than a square's
_KEYS = ("gel", "own", "bubble", "exact", "pose", "thing")  # of a kept touch
_MOST_KEPT = 4096  # touches in a worker's memory, a quarter of a megabyte each
_MOST_EMPTY = 100  # presses in a row that one of the two does not feel


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchSquares:
    """Both readings of a press as squares, and what was pressed where."""

    gel_change: Floats  # (3, side, side) change of the picture, in shares of full brightness
    nominal_gel_change: Floats  # (3, side, side) the same surface as the described unit pictures it
    bubble_imprint_mm: Floats  # (1, side, side) imprint as the depth camera gives it
    exact_imprint_mm: Floats  # (1, side, side) the imprint itself
    alignment_from_object: Doubles  # (4, 4) mm
    object_name: str  # a name of the catalogue; "" = a body of its own


def simulate_touch_squares(things: PairedDataSplit, seed: int, index: int, folder: str = "") -> TouchSquares:
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
        if found.exact_imprint_mm.any() and found.gel_change.any():
            return found
    raise SettingProblem(f"none of {_MOST_EMPTY} presses from {index} on is felt; choose another seed")


def _pressed(things: PairedDataSplit, seed: int, number: int) -> TouchSquares:
    rng = np.random.default_rng([VERSION, 3, _KINDS.index(things), seed, number])
    name, thing = _thing(things, rng, number)
    pose = poses.sample_press_pose(thing, rng)
    units = [variation.vary_sensor(unit, int(rng.integers(1 << 31)), 1.0) for unit in load_nominal_sensors()]
    own, felt = load_nominal_sensors()[0], True
    squares: list[Floats] = []
    for unit in units:
        seeds = [int(s) for s in rng.integers(1 << 31, size=2)]
        looked_at = unit if unit.kind == "bubble" else unit.with_camera(unit.camera.scale(1.0 / _COARSER))
        truth = simulate_press(thing, pose, looked_at, seed=None)
        moved, contact = truth.truth.indentation_mm, truth.truth.contact
        assert moved is not None
        assert contact is not None
        felt &= truth.converged and bool(contact.any())
        moved = _sized(moved, unit.camera.shape)
        for pictured in (unit, own) if unit.kind == "gel" else (unit,):
            image = render_sensor_image(pictured, moved, pictured.rest_depth_mm - moved, seeds[0])
            untouched = render_sensor_image(pictured, np.zeros_like(moved), pictured.rest_depth_mm, seeds[1])
            squares.append(resize_to_square(compute_change(pictured.kind, image, untouched)))
        if unit.kind == "bubble":
            squares.append(resize_to_square(moved[..., None]))
    if not felt:
        squares = [np.zeros_like(s) for s in squares]
    return TouchSquares(
        gel_change=_as_kept(squares[0]), nominal_gel_change=_as_kept(squares[1]), bubble_imprint_mm=_halved(squares[2]),
        exact_imprint_mm=_halved(squares[3]), alignment_from_object=freeze(pose), object_name=name,
    )  # fmt: skip


def _sized(field: Floats, shape: tuple[int, int]) -> Floats:
    import cv2

    if field.shape == shape:
        return field
    return np.asarray(cv2.resize(field, shape[::-1], interpolation=cv2.INTER_CUBIC), np.float32)


@lru_cache(maxsize=1)
def load_nominal_sensors() -> tuple[SensorSpec, SensorSpec]:
    """The gel, and the bubble that comes to meet the object as in data sets."""
    bubble = load_sensor("soft_bubble")
    nearer = rigid.translation(0.0, 0.0, BUBBLE_DEEPER_MM) @ bubble.alignment_from_sensor
    return load_sensor("gelslim"), replace(bubble, alignment_from_sensor=freeze(nearer))


def _thing(things: PairedDataSplit, rng: np.random.Generator, number: int) -> tuple[str, Mesh]:
    if things == "learned" and rng.random() >= _CATALOGUE:
        return "", make_random_body(rng)
    names = {
        "learned": shapes.list_shapes("training"), "unseen_grasps": shapes.list_shapes("training"),
        "unseen_tools": shapes.list_shapes("unseen"), "own": shapes.list_labelled_shapes(),
    }[things]  # fmt: skip
    name = names[int(rng.integers(len(names))) if things == "learned" else number % len(names)]
    return name, shapes.make_shape(name).mesh


def _as_kept(a: Floats) -> Floats:
    """As a file gives it back: kept or not, a touch is the same."""
    return _seen(_steps(a))


def _steps(a: Floats) -> NDArray[Any]:
    return np.rint(a * np.float32(_STEPS)).astype(np.int16)


def _seen(steps: NDArray[Any]) -> Floats:
    return freeze((steps / np.float32(_STEPS)).astype(np.float32))


def _halved(a: Floats) -> Floats:
    return freeze(a.astype(np.float16).astype(np.float32))


def _keep(path: Path, found: TouchSquares) -> None:
    content = io.BytesIO()
    np.savez_compressed(
        content, gel=_steps(found.gel_change), own=_steps(found.nominal_gel_change), bubble=found.bubble_imprint_mm.astype(np.float16),
        exact=found.exact_imprint_mm.astype(np.float16), pose=found.alignment_from_object, thing=np.array(found.object_name),
    )  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    with open_atomic(path, "a touch to learn from") as file:
        file.write(content.getbuffer())


def _kept(path: Path) -> TouchSquares | None:
    try:
        gel, own, bubble, exact, pose, thing = _load_packed(path)
    except FileNotFoundError:
        return None  # not there yet, or damaged: it is pressed again
    return TouchSquares(
        gel_change=_seen(gel), nominal_gel_change=_seen(own), bubble_imprint_mm=freeze(bubble.astype(np.float32)),
        exact_imprint_mm=freeze(exact.astype(np.float32)), alignment_from_object=freeze(pose), object_name=str(thing),
    )  # fmt: skip


@lru_cache(maxsize=_MOST_KEPT)
def _load_packed(path: Path) -> tuple[NDArray[Any], ...]:
    """The arrays of a file, kept small in memory: every touch is drawn many times. Raises FileNotFoundError."""
    kept = read_cached_arrays(path)
    if kept is None or not set(_KEYS) <= set(kept):
        raise FileNotFoundError(path)
    return tuple(kept[key] for key in _KEYS)
