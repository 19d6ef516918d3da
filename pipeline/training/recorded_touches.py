"""A user's own recordings among the simulated examples: our HDF5 with its truth, and presses of a ball of known size.

Of a press of a ball its place and how far it stands out are seen, by a look-up that is fitted to all of the presses;
the layer's mechanics say how deep a ball of this size lies then, and how the gel lies under and around it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.base.params import setting
from pipeline.calibration.balls import calibrate_balls
from pipeline.calibration.calibration_table import BallFit
from pipeline.physics import gel
from pipeline.recordings import open_recording
from pipeline.sensors.spec import SensorSpec
from pipeline.sensors.spec import load_sensor as sensor_named
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.training.task import Split, Task
from pipeline.values.frames import Stream, TactileFrame

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.task import Example

_COARSE = 4  # pixels to a lattice step while the depth of a ball is looked for
_HALVINGS = 9
_AROUND = (1.6, 2.2)  # contact radii: what a ball stands out from


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingSource:
    """One recording, as a recipe names it under [[data.recordings]]."""

    path: str = setting("", "File or folder")
    sensor: str = setting("", "Sensor", help="where the recording does not say")
    stream: str = setting("", "Stream")
    reference: str = setting("", "Image of the untouched sensor", help="where the recording holds none")
    diameter_mm: float = setting(0.0, "Diameter of the ball", unit="mm", low=0.0, high=1000.0, help="0 = no ball")


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelledTouch:
    """A touch that was really recorded, with what is true of it on the frame's own grid."""

    frame: TactileFrame
    source: SensorSpec  # seen through the frame's own camera
    indentation_mm: Floats
    contact: Mask


class LearnsFromTouches(Protocol):
    """What a task has that learns from recordings, too."""

    def make_touch_example(self, known: LabelledTouch, rng: np.random.Generator) -> Example:
        """An example of the same arrays as a simulated one."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class MixedTask:
    """A task a share of whose examples are own touches; all else is the task's."""

    task: Task
    recordings: tuple[RecordingSource, ...]
    recorded_share: float

    def sample(self, rng: np.random.Generator) -> Example:
        """A touch of the recordings, each of them as likely, or a simulated one."""
        if rng.random() >= self.recorded_share:
            return self.task.sample(rng)
        own = self.recordings[int(rng.integers(len(self.recordings)))]
        known = load_touch(own, int(rng.integers(count_touches(own))))
        return cast("LearnsFromTouches", self.task).make_touch_example(known, rng)

    def make_validation_example(self, split: Split, index: int) -> Example:
        """The task's."""
        return self.task.make_validation_example(split, index)

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """The task's."""
        return self.task.compute_loss(network, batch)

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """The task's."""
        return self.task.evaluate(network, held_out)


def mix_recordings(task: Task, recordings: tuple[RecordingSource, ...], share: float) -> Task:
    """`task` with own touches for a share of its examples; `task` itself where there are none.

    Every recording is opened once, so that what is wrong with one is said before the training begins. Raises
    FileProblem, and SettingProblem for a task that does not learn from recordings.
    """
    if not recordings or share <= 0.0:
        return task
    if not hasattr(task, "make_touch_example"):
        raise SettingProblem(f"the task {type(task).__name__} learns from simulated touches alone; leave out [data]")
    for own in recordings:
        if not count_touches(own):
            raise FileProblem("no frame of this recording has a truth to learn from", own.path)
    return MixedTask(task=task, recordings=recordings, recorded_share=share)


def count_touches(own: RecordingSource) -> int:
    """How many touches of a recording can be learned from."""
    return len(_balls(own)) if own.diameter_mm else len(_with_truth(own))


def load_touch(own: RecordingSource, index: int) -> LabelledTouch:
    """One of them."""
    if own.diameter_mm:
        return _balls(own)[index]
    stream, source = _opened(own)
    number = _with_truth(own)[index]
    frame, truth = stream.frame(number), stream.truth(number)
    assert truth is not None
    assert truth.indentation_mm is not None
    assert truth.contact is not None
    return LabelledTouch(
        frame=frame, source=source if frame.camera is None else source.with_camera(frame.camera),
        indentation_mm=truth.indentation_mm, contact=truth.contact,
    )  # fmt: skip


@lru_cache(maxsize=32)
def _opened(own: RecordingSource) -> tuple[Stream, SensorSpec]:
    recording = open_recording(
        Path(own.path), sensor=own.sensor, reference=Path(own.reference) if own.reference else None
    )
    stream = recording.stream(own.stream or own.sensor)
    if not (own.sensor or stream.sensor):
        raise FileProblem("the recording does not say which sensor made it; name it in the recipe", own.path)
    return stream, sensor_named(own.sensor or stream.sensor)


@lru_cache(maxsize=32)
def _with_truth(own: RecordingSource) -> tuple[int, ...]:
    stream, _ = _opened(own)
    truths = (stream.truth(index) for index in range(stream.n_frames))
    return tuple(
        index
        for index, truth in enumerate(truths)
        if truth is not None and truth.indentation_mm is not None and truth.contact is not None
    )


@lru_cache(maxsize=8)
def _balls(own: RecordingSource) -> tuple[LabelledTouch, ...]:
    """The presses of a folder in which the ball was found."""
    stream, source = _opened(own)
    frames = [stream.frame(index) for index in range(stream.n_frames)]
    reference = frames[0].reference if frames else None
    if reference is None or reference.ndim != 3 or source.gel is None:
        raise FileProblem("presses of a ball need a gel's pictures and one of the untouched sensor", own.path)
    found = calibrate_balls(
        [cast("Image", frame.image) for frame in frames], cast("Image", reference), source, own.diameter_mm
    )
    knowns: list[LabelledTouch] = []
    for fit in found.presses:
        if fit.used:
            frame = frames[fit.index]
            seen = estimate_depth(frame, source, found, DepthParams()).indentation_mm
            surface, contact = simulate_ball_press(source, seen, 0.5 * own.diameter_mm, fit)
            knowns.append(LabelledTouch(frame=frame, source=source, indentation_mm=surface, contact=contact))
    return tuple(knowns)


def simulate_ball_press(source: SensorSpec, seen_mm: Floats, ball_mm: float, fit: BallFit) -> tuple[Floats, Mask]:
    """Indentation and contact of a ball of that radius, pressed until it stands out as far as the one that was seen."""
    assert source.gel is not None
    y, x = np.ogrid[: seen_mm.shape[0], : seen_mm.shape[1]]
    r_sq = (x - fit.x_px) ** 2 + (y - fit.y_px) ** 2
    middle, around = (r_sq < (share * fit.radius_px) ** 2 for share in (1.0, _AROUND[1]))
    around &= r_sq > (_AROUND[0] * fit.radius_px) ** 2
    reach = (-ball_mm + np.sqrt(np.maximum(ball_mm**2 - r_sq * source.pixel_mm**2, 0.0))).astype(np.float32)

    def measure_protrusion(surface: Floats, step: int) -> float:
        inside, beside = (surface[mask[::step, ::step]] for mask in (middle, around))
        return float(inside.mean()) - (float(beside.mean()) if beside.size else 0.0)

    wanted, low, high = measure_protrusion(seen_mm, 1), 0.0, min(ball_mm, source.gel.thickness_mm)
    for _ in range(_HALVINGS):
        deep = np.float32(0.5 * (low + high))
        tried = gel.press_gel(source.gel, _COARSE * source.pixel_mm, reach[::_COARSE, ::_COARSE] + deep)
        low, high = (
            (float(deep), high) if measure_protrusion(tried.indentation_mm, _COARSE) < wanted else (low, float(deep))
        )
    answer = gel.press_gel(source.gel, source.pixel_mm, reach + np.float32(0.5 * (low + high)))
    return freeze(answer.indentation_mm.astype(np.float32)), freeze(answer.contact)
