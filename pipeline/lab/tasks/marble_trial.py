"""One trial of marble rolling: its start, its load, and what the sensors under the ball record."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np

from pipeline.core.arrays import Doubles, Image
from pipeline.core.geometry import rigid
from pipeline.core.values.frames import TactileFrame, Truth
from pipeline.lab.tasks.rolling import RADIUS_MM, TICK_S, RollingBall, make_ball
from pipeline.lab.tasks.touches import Moment, SensorPlace, place_sensor
from pipeline.physics.simulation.press import simulate_press

SOURCE = "digit"
TARGET = "gelslim"
N_TICKS = 60
# distance from the centre; both sensors see the whole contact
START_MM = (2.0, 3.7)
INDENTATION_MM = (0.3, 0.6)
# touches before a trial that show the DIGIT's LEDs
_CONTEXT_MM = ((2.0, 2.0), (-2.0, 2.0), (2.0, -2.0), (-2.0, -2.0))
RecordedFrame = tuple[TactileFrame, Truth | None]


@dataclass(frozen=True, kw_only=True)
class MarbleTrial:
    """What all touches of one trial share: the start, the load, and the sensor instances."""

    start_mm: tuple[float, float]
    indentation_mm: float
    source: SensorPlace
    target: SensorPlace

    @cached_property
    def load_n(self) -> float:
        """Force at which the target's gel is indented so far."""
        pose = rigid.translation(0.0, 0.0, RADIUS_MM - self.indentation_mm)
        return simulate_press(make_ball(), pose, self.target.nominal, seed=None).force_n

    @cached_property
    def context_images(self) -> tuple[Image, ...]:
        """Images of the source from before the trial."""
        poses = [rigid.translation(x, y, RADIUS_MM - self.indentation_mm) for x, y in _CONTEXT_MM]
        recorded = [
            self.source.record(make_ball(), pose, index=N_TICKS + k, time_s=0.0)
            for k, pose in enumerate(poses)
        ]
        return tuple(cast("Image", frame.image) for frame, _ in recorded)

    def start(self, replayed: Sequence[Doubles] = ()) -> RollingBall:
        """The ball at its start, or after these steps of the plate."""
        ball = RollingBall(self.start_mm, self.load_n)
        for step_mm in replayed:
            ball.move_plate(step_mm)
        return ball

    def record(self, sensor: str, ball: RollingBall, tick: int) -> RecordedFrame:
        """The frame of the source or the target at this tick."""
        pose = rigid.translation(0.0, 0.0, -self.indentation_mm) @ ball.plate_from_ball
        place = self.source if sensor == SOURCE else self.target
        return place.record(make_ball(), pose, index=tick, time_s=TICK_S * tick)

    def make_moment(self, frames: Sequence[RecordedFrame]) -> Moment:
        """One tick's frames as a moment that can be translated."""
        return Moment(
            make_ball(),
            frames,
            self.source.nominal,
            self.target.nominal,
            context_images=self.context_images,
            draft=True,
        )


def draw_trial(seed: int, index: int, vary: float) -> MarbleTrial:
    """Trial `index` of a seed."""
    rng = np.random.default_rng([seed, zlib.crc32(b"marble"), index])
    distance = rng.uniform(*START_MM)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    indentation = float(rng.uniform(*INDENTATION_MM))
    source, target = (place_sensor(name, rng, vary) for name in (SOURCE, TARGET))
    start = (float(distance * np.cos(angle)), float(distance * np.sin(angle)))
    return MarbleTrial(start_mm=start, indentation_mm=indentation, source=source, target=target)
