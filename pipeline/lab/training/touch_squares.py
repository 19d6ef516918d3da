"""Touches that a GelSlim and a bubble record of the same press, resized to squares, with the
object's pose.

Sensor instances differ from press to press as those of a lab do, and frames have their cameras'
noise. The gel's surface is also rendered by the nominal sensor, for which touches are generated.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.core.arrays import Doubles, Floats, freeze
from pipeline.core.derived import derive_once
from pipeline.lab.training.object_sampling import (
    DATA_SPLITS,
    DataSplit,
    SampleCache,
    find_next_contact,
    sample_object,
)
from pipeline.lab.training.recorded_pairs import RecordedPair
from pipeline.lab.training.touch_pairs import BUBBLE, GEL
from pipeline.physics.sensor_images import render_reference, render_sensor_image
from pipeline.physics.simulation import poses, variation
from pipeline.physics.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.physics.simulation.press import move_bubble_closer, simulate_press
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.networks.touch_formats import SIDE, resize_to_square

Direction = Literal["gel_to_bubble", "bubble_to_gel"]
VERSION = 3  # part of the seeds: incremented when the same number gives another touch
_CATALOGUE_SHARE = 0.6  # training objects in training; the others are random bodies
_GEL_DOWNSAMPLING = 3  # of the gel's contact, which is still finer than a square


@dataclass(frozen=True, slots=True)
class SquarePair:
    """Changes (channels, side, side) of a source and a target, each with the kind of its sensor."""

    source: Floats
    source_kind: str
    target: Floats
    target_kind: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchSquares:
    """Both frames of a press as squares, with the object and its pose."""

    gel_change: Floats  # (3, side, side) change of the image, in shares of full brightness
    nominal_gel_change: Floats  # (3, side, side) the same surface rendered by the nominal sensor
    bubble_imprint_mm: Floats  # (1, side, side) with the depth camera's noise
    exact_imprint_mm: Floats  # (1, side, side)
    alignment_from_object: Doubles  # (4, 4) mm
    object_name: str  # of the catalogue; "" = a random body

    def get_pair(self, direction: Direction) -> SquarePair:
        """The source as any instance records it, the target nominal and exact."""
        if direction == "gel_to_bubble":
            return SquarePair(self.gel_change, "gel", self.exact_imprint_mm, "bubble")
        return SquarePair(self.bubble_imprint_mm, "bubble", self.nominal_gel_change, "gel")


_touches = SampleCache(TouchSquares)


def simulate_touch_squares(
    split: DataSplit, seed: int, index: int, folder: str = ""
) -> TouchSquares:
    """Touch `index` of a seed, or the next with contact on both sensors; the same on every call.

    Raises SettingProblem where none of the next hundred has one.
    """

    def simulate(k: int) -> TouchSquares | None:
        touch = _touches.get(
            f"squares_{split}_{seed}_{k}", folder, lambda: _simulate_squares(split, seed, k)
        )
        return touch if touch.exact_imprint_mm.any() and touch.gel_change.any() else None

    return find_next_contact(simulate, index)


def read_square_pair(pair: RecordedPair, side: int = SIDE) -> SquarePair:
    """Squares of a recorded pair; a missing reference is the described one."""
    changes: list[Floats] = []
    for frame, sensor in ((pair.source_frame, pair.source), (pair.target_frame, pair.target)):
        reference = render_reference(sensor) if frame.reference is None else frame.reference
        changes.append(
            resize_to_square(
                sensor.sensor_kind.compute_relative_change(frame.image, reference), side
            )
        )
    return SquarePair(changes[0], pair.source.kind, changes[1], pair.target.kind)


def list_pair_sensors(target: str) -> tuple[str, str]:
    """Names of source and target."""
    return (GEL, BUBBLE) if target == BUBBLE else (BUBBLE, GEL)


def _simulate_squares(split: DataSplit, seed: int, index: int) -> TouchSquares:
    rng = np.random.default_rng([VERSION, 3, DATA_SPLITS.index(split), seed, index])
    name, mesh = sample_object(split, rng, index, catalogue_share=_CATALOGUE_SHARE)
    pose = poses.sample_press_pose(mesh, rng)
    nominal = load_nominal_sensors()
    instances = [variation.vary_sensor(spec, int(rng.integers(1 << 31)), 1.0) for spec in nominal]
    has_contact = True
    squares = list[Floats]()
    for instance in instances:
        seeds = [int(s) for s in rng.integers(1 << 31, size=2)]
        is_gel = instance.gel is not None
        solved = (
            instance.with_camera(instance.camera.scale(1.0 / _GEL_DOWNSAMPLING))
            if is_gel
            else instance
        )
        press = simulate_press(mesh, pose, solved, seed=None)
        has_contact &= press.converged and bool(press.contact.any())
        indentation = _resize(press.indentation_mm, instance.camera.shape)
        for sensor in (instance, nominal[0]) if is_gel else (instance,):
            image = render_sensor_image(
                sensor, indentation, sensor.rest_depth_mm - indentation, seeds[0]
            )
            reference = render_sensor_image(
                sensor, np.zeros_like(indentation), sensor.rest_depth_mm, seeds[1]
            )
            squares.append(
                resize_to_square(sensor.sensor_kind.compute_relative_change(image, reference))
            )
        if not is_gel:
            squares.append(resize_to_square(indentation[..., None]))
    if not has_contact:
        squares = [np.zeros_like(square) for square in squares]
    return TouchSquares(
        gel_change=squares[0],
        nominal_gel_change=squares[1],
        bubble_imprint_mm=squares[2],
        exact_imprint_mm=squares[3],
        alignment_from_object=freeze(pose),
        object_name=name,
    )


def _resize(field: Floats, shape: tuple[int, int]) -> Floats:
    import cv2

    if field.shape == shape:
        return field
    return np.asarray(cv2.resize(field, shape[::-1], interpolation=cv2.INTER_CUBIC), np.float32)


@derive_once
def load_nominal_sensors() -> tuple[SensorSpec, SensorSpec]:
    """The gel, and the bubble as close to the object as in the data sets."""
    return load_sensor("gelslim"), move_bubble_closer(load_sensor("soft_bubble"), BUBBLE_DEEPER_MM)
