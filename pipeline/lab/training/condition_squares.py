"""Simulated touches as squares for the paper's generators: what the network is conditioned on, and
the target's image.

Touch to touch needs pairs of a gel and a bubble (`touch_pairs`), touch to depth to touch the
target's own touches alone (`target_touches`). The target is as described and without noise; the
source is any sensor instance, with noise.
"""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from pipeline.core.arrays import Floats
from pipeline.lab.training.object_sampling import DataSplit, find_next_contact
from pipeline.lab.training.target_touches import simulate_target_touch
from pipeline.lab.training.touch_pairs import (
    BUBBLE,
    TouchPair,
    mirror_pair,
    place_nominal_sensors,
    simulate_touch_pair,
)
from pipeline.physics.sensor_images import render_reference, render_sensor_image
from pipeline.sensors.alignment import resolve_alignment
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.networks.square_images import resize_to_square
from pipeline.stages.touch.depth_condition import build_depth_square, make_working_sensor
from pipeline.stages.touch.latent_diffusion import build_image_square

# of one depth frame of a bubble
_NOISE_MM = 0.4
_GRAIN_PX = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class SquareRequest:
    """Which examples: the target sensor, the condition of the network, and where touches come
    from.
    """

    target: str
    condition: str  # of `networks.latent_diffusion.Condition`
    side: int
    folder: str = ""

    def make_example(
        self,
        split: DataSplit,
        seed: int,
        index: int,
        rng: np.random.Generator,
        augmented: bool = False,
    ) -> tuple[Floats, Floats]:
        """(condition (channels, side, side), the target's change (channels, side, side)) of touch
        `index`.

        `augmented`: rotated by 180 degrees or mirrored. A gel's image is rendered anew then, as its
        LEDs are not symmetric. Where touch `index` has no contact, the next one with contact is
        used.
        """
        if self.condition == "depth":
            return self._make_depth_example(split, seed, index, rng, augmented)
        return self._make_pair_example(split, seed, index, rng, augmented)

    def _make_depth_example(
        self, split: DataSplit, seed: int, index: int, rng: np.random.Generator, augmented: bool
    ) -> tuple[Floats, Floats]:
        touch = find_next_contact(
            lambda k: simulate_target_touch(self.target, split, seed, k, self.folder), index
        )
        sensor = make_working_sensor(load_sensor(self.target))
        fields = touch.observed_mm, touch.observed, touch.in_view, touch.target_mm
        observed_mm, observed, in_view, target_mm = _flip(fields, rng) if augmented else fields
        condition = build_depth_square(sensor.kind, observed_mm, observed, in_view, self.side)
        return condition, self._render_target(sensor, target_mm)

    def _make_pair_example(
        self, split: DataSplit, seed: int, index: int, rng: np.random.Generator, augmented: bool
    ) -> tuple[Floats, Floats]:
        onto_bubble = self.target == BUBBLE

        def find(k: int) -> TouchPair | None:
            return simulate_touch_pair(split, seed, k, self.folder, bubble_alone=not onto_bubble)

        pair = find_next_contact(find, index)
        pair = mirror_pair(pair, rng) if augmented else pair
        gel, bubble = place_nominal_sensors(pair.placement)
        if onto_bubble:
            noisy = pair.change_grey + rng.normal(0.0, 1.0, pair.change_grey.shape).astype(
                np.float32
            )
            source = gel
            target = bubble
            change = noisy / np.float32(255.0)
            target_mm = pair.bubble_mm
        else:
            noisy = pair.bubble_mm + sample_depth_noise(rng, pair.bubble_mm.shape)
            source = bubble
            target = gel
            change = noisy[..., None]
            target_mm = pair.gel_mm
        square = resize_to_square(change, self.side)
        condition = build_image_square(
            square, self.condition, source, target, resolve_alignment(source, target)
        )
        return condition, self._render_target(target, target_mm)

    def _render_target(self, sensor: SensorSpec, indentation_mm: Floats) -> Floats:
        image = render_sensor_image(
            sensor, indentation_mm, sensor.rest_depth_mm - indentation_mm, None
        )
        change = sensor.sensor_kind.compute_relative_change(image, render_reference(sensor))
        return resize_to_square(change, self.side)


def sample_depth_noise(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Noise in mm of the difference of two depth frames of a bubble."""
    import cv2

    white = rng.standard_normal(shape).astype(np.float32)
    grains = np.asarray(cv2.GaussianBlur(white, (0, 0), _GRAIN_PX), np.float32)
    return grains * np.float32(np.sqrt(2.0) * _NOISE_MM * rng.uniform(0.7, 1.2) / grains.std())


def _flip(fields: tuple[Any, ...], rng: np.random.Generator) -> tuple[Any, ...]:
    """The fields (rows, cols), rotated by 180 degrees or mirrored together."""
    axes = cast("tuple[int, ...]", ((0,), (1,), (0, 1))[int(rng.integers(3))])
    return tuple(np.ascontiguousarray(np.flip(field, axes)) for field in fields)
