"""Touches that a gel and a bubble record of the same press, for touch to touch.

The bubble's camera is widened to be symmetric about its axis, so that a pair can be mirrored: the
mirrored pair is what the mirrored object gives. The gel's image is rendered anew then, by another
sensor instance, since its LEDs are not symmetric.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.lab.training.object_sampling import DATA_SPLITS, DataSplit, SampleCache, sample_object
from pipeline.lab.training.target_touches import (
    CATALOGUE_SHARE,
    SMALL_SHARE,
    TRAINING_DEPTH_MM,
)
from pipeline.physics import optics
from pipeline.physics.simulation import poses, variation
from pipeline.physics.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.touch.depth_condition import make_working_sensor

VERSION = 5  # part of the seeds: incremented when the same number gives another pair
GEL = "gelslim"
BUBBLE = "soft_bubble"
_AS_RECORDED_SHARE = 0.25  # bubbles that stand as in the data sets
# ranges of all other bubbles' placements, about that of their description
_CLOSER_MM = (-6.0, 10.0)  # its apex is 4 mm inside a gel's surface at 0
_ASIDE_MM = 3.5
_ROTATION_DEG = (2.0, 2.0, 22.0)
# training presses that only a bubble feels: share, depth over the gel
_ABOVE_SHARE = 0.06
_ABOVE_MM = (-4.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchPair:
    """Both sides of a touch on their working grids."""

    change_grey: Floats  # (rows, cols, 3) change of the gel's image, with noise
    gel_mm: Floats  # (rows, cols) indentation
    gel_contact: Mask
    symmetric_bubble_mm: Floats  # (rows, cols) of the symmetric camera, without noise
    symmetric_bubble_contact: Mask
    placement: Doubles  # (4, 4) mm, what moves the bubble from its description

    @property
    def bubble_mm(self) -> Floats:
        """Indentation (rows, cols) in the bubble's own camera."""
        return self.symmetric_bubble_mm[_crop_to_camera()]

    @property
    def bubble_contact(self) -> Mask:
        """Contact (rows, cols) in the bubble's own camera."""
        return self.symmetric_bubble_contact[_crop_to_camera()]


_pairs = SampleCache(TouchPair)


def place_nominal_sensors(placement: Doubles, gel: str = GEL) -> tuple[SensorSpec, SensorSpec]:
    """Gel and bubble as described, on their working grids, the bubble moved by `placement`."""
    nominal, bubble = _load_working_sensor(gel), _load_working_sensor(BUBBLE)
    moved: Doubles = freeze(placement @ bubble.alignment_from_sensor)
    return nominal, replace(bubble, alignment_from_sensor=moved)


def simulate_touch_pair(
    split: DataSplit,
    seed: int,
    index: int,
    folder: str = "",
    *,
    gel: str = GEL,
    bubble_alone: bool = False,
) -> TouchPair | None:
    """Pair `index` of a seed, the same on every call; None where the gel has no contact.

    With `bubble_alone` contact on the bubble is enough.
    """

    def make() -> TouchPair:
        return _simulate_pair(
            split,
            np.random.default_rng([VERSION, 13, DATA_SPLITS.index(split), seed, index]),
            index,
            gel,
        )

    pair = _pairs.get(f"pair_{gel}_{split}_{seed}_{index}", folder, make)
    has_contact = pair.gel_contact.any() or (bubble_alone and pair.bubble_contact.any())
    return pair if has_contact else None


def _simulate_pair(
    split: DataSplit, rng: np.random.Generator, index: int, gel_name: str = GEL
) -> TouchPair:
    as_recorded = split != "training" or rng.random() < _AS_RECORDED_SHARE
    placement = (
        rigid.translation(0.0, 0.0, BUBBLE_DEEPER_MM) if as_recorded else _sample_placement(rng)
    )
    gel, bubble = (
        variation.vary_sensor(spec, int(rng.integers(1 << 31)), 1.0)
        for spec in place_nominal_sensors(placement, gel_name)
    )
    bubble = bubble.with_camera(make_symmetric_camera(bubble.camera))
    _, mesh = sample_object(
        split, rng, index, catalogue_share=CATALOGUE_SHARE, small_share=SMALL_SHARE
    )
    depth_mm = poses.DEPTH_RANGE_MM if split != "training" else TRAINING_DEPTH_MM
    if split == "training" and rng.random() < _ABOVE_SHARE:
        depth_mm = _ABOVE_MM
    pose = poses.sample_press_pose(mesh, rng, depth_mm=depth_mm)
    on_gel = simulate_press(mesh, pose, gel, seed=int(rng.integers(1 << 31)))
    on_bubble = simulate_press(mesh, pose, bubble, seed=None)
    change = on_gel.image.astype(np.float32) - optics.render_reference(gel).astype(np.float32)
    return TouchPair(
        change_grey=change,
        gel_mm=on_gel.indentation_mm,
        gel_contact=on_gel.contact,
        symmetric_bubble_mm=on_bubble.indentation_mm,
        symmetric_bubble_contact=on_bubble.contact,
        placement=freeze(placement),
    )


def _sample_placement(rng: np.random.Generator) -> Doubles:
    motion = rigid.rotation(np.deg2rad(_ROTATION_DEG) * rng.uniform(-1.0, 1.0, 3))
    motion[:3, 3] = *rng.uniform(-_ASIDE_MM, _ASIDE_MM, 2), rng.uniform(*_CLOSER_MM)
    return motion


def mirror_pair(pair: TouchPair, rng: np.random.Generator, gel_name: str = GEL) -> TouchPair:
    """The pair mirrored across x, y, both or neither.

    The gel's image is rendered by another sensor instance.
    """
    which = int(rng.integers(4))
    axes = tuple(axis for axis, flips in ((-1, which & 1), (-2, which & 2)) if flips)

    def flip_field(field: NDArray[Any]) -> Any:
        return freeze(np.ascontiguousarray(np.flip(field, axes)))

    gel_mm = flip_field(pair.gel_mm)
    gel = variation.vary_sensor(_load_working_sensor(gel_name), int(rng.integers(1 << 31)), 1.0)
    image = optics.render(gel, gel_mm, seed=int(rng.integers(1 << 31)))
    change = image.astype(np.float32) - optics.render_reference(gel).astype(np.float32)
    mirror = np.diag([-1.0 if which & 1 else 1.0, -1.0 if which & 2 else 1.0, 1.0, 1.0])
    return replace(
        pair,
        change_grey=freeze(change),
        gel_mm=gel_mm,
        gel_contact=flip_field(pair.gel_contact),
        symmetric_bubble_mm=flip_field(pair.symmetric_bubble_mm),
        symmetric_bubble_contact=flip_field(pair.symmetric_bubble_contact),
        placement=freeze(mirror @ pair.placement @ mirror),
    )


def make_symmetric_camera(camera: Camera) -> Camera:
    """The smallest camera that holds all pixels of this one and has its axis in the middle, to
    half a pixel.
    """
    (before_x, cols), (before_y, rows) = (
        _pad_axis(camera.cx_px, camera.cols),
        _pad_axis(camera.cy_px, camera.rows),
    )
    return replace(
        camera, rows=rows, cols=cols, cx_px=camera.cx_px + before_x, cy_px=camera.cy_px + before_y
    )


def _pad_axis(centre_px: float, n: int) -> tuple[int, int]:
    """(pixels to add before the first of `n`, pixels then)."""
    more = round(n - 1 - 2 * centre_px)  # pixels behind the centre less those before it
    return max(more, 0), n + abs(more)


@derive_once
def _crop_to_camera() -> tuple[slice, slice]:
    """The pixels of the bubble's own camera in the symmetric one."""
    camera = _load_working_sensor(BUBBLE).camera
    x = _pad_axis(camera.cx_px, camera.cols)[0]
    y = _pad_axis(camera.cy_px, camera.rows)[0]
    return slice(y, y + camera.rows), slice(x, x + camera.cols)


@derive_once
def _load_working_sensor(name: str) -> SensorSpec:
    return make_working_sensor(load_sensor(name))
