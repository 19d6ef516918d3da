"""Recordings of the user as training examples: recordings with truth, and presses of a ball of known size.

The position and protrusion of each ball are estimated with a calibration table fitted to all presses. The mechanics of
the layer give the depth of a ball of this size, and the gel's surface under and around it.
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
from pipeline.engine.derived import derive_once
from pipeline.physics import gel
from pipeline.recordings import open_recording
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.training.task import Split, Task
from pipeline.values.frames import Stream, TactileFrame, Truth

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.task import Example

_COARSE = 4  # pixels to a lattice step while the depth of a ball is searched
_N_BISECTIONS = 9
_AROUND = (1.6, 2.2)  # contact radii: the ring that a ball's protrusion is measured from


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingSource:
    """One recording, as a recipe names it under [[data.recordings]]."""

    path: str = setting("", "File or folder")
    sensor: str = setting("", "Sensor", help="if the recording does not name it")
    stream: str = setting("", "Stream")
    reference: str = setting("", "Reference image", help="if the recording has none")
    diameter_mm: float = setting(0.0, "Ball diameter", unit="mm", low=0.0, high=1000.0, help="0 = no ball")


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelledTouch:
    """A recorded touch with its truth on the frame's grid."""

    frame: TactileFrame
    source: SensorSpec  # with the frame's camera
    indentation_mm: Floats
    contact: Mask


class LearnsFromTouches(Protocol):
    """Further method of a task that trains on recorded touches."""

    def make_touch_example(self, known: LabelledTouch, rng: np.random.Generator) -> Example:
        """An example with the arrays of a simulated one."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class MixedTask:
    """A task with a share of recorded examples; everything else is the task's."""

    task: Task
    recordings: tuple[RecordingSource, ...]
    recorded_share: float

    def sample(self, rng: np.random.Generator) -> Example:
        """A recorded touch, each recording with the same probability, or a simulated one."""
        if rng.random() >= self.recorded_share:
            return self.task.sample(rng)
        source = self.recordings[int(rng.integers(len(self.recordings)))]
        known = load_touch(source, int(rng.integers(count_touches(source))))
        return cast("LearnsFromTouches", self.task).make_touch_example(known, rng)

    def make_validation_example(self, split: Split, index: int) -> Example:
        """As the task computes it; see `pipeline.training.task.Task`."""
        return self.task.make_validation_example(split, index)

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """As the task computes it; see `pipeline.training.task.Task`."""
        return self.task.compute_loss(network, batch)

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """As the task computes it; see `pipeline.training.task.Task`."""
        return self.task.evaluate(network, held_out)


def mix_recordings(task: Task, recordings: tuple[RecordingSource, ...], share: float) -> Task:
    """`task` with recorded touches for a share of its examples; `task` itself without recordings.

    Opens every recording, so that errors show before training starts. Raises FileProblem, and SettingProblem for a task
    that cannot use recordings.
    """
    if not recordings or share <= 0.0:
        return task
    if not hasattr(task, "make_touch_example"):
        raise SettingProblem(f"the task {type(task).__name__} trains on simulated touches alone; remove [data]")
    for source in recordings:
        if not count_touches(source):
            raise FileProblem("no frame of this recording has a truth to train on", source.path)
    return MixedTask(task=task, recordings=recordings, recorded_share=share)


def count_touches(recording: RecordingSource) -> int:
    """Number of touches of a recording with a truth."""
    return len(_load_balls(recording)) if recording.diameter_mm else len(_list_frames_with_truth(recording))


def load_touch(recording: RecordingSource, index: int) -> LabelledTouch:
    """Touch `index` of those with a truth."""
    if recording.diameter_mm:
        return _load_balls(recording)[index]
    stream, source = _open(recording)
    number = _list_frames_with_truth(recording)[index]
    frame, truth = stream.frame(number), stream.truth(number)
    assert truth is not None
    assert truth.indentation_mm is not None
    return LabelledTouch(
        frame=frame, source=source if frame.camera is None else source.with_camera(frame.camera),
        indentation_mm=truth.indentation_mm, contact=derive_contact(truth, source),
    )  # fmt: skip


def derive_contact(truth: Truth, sensor: SensorSpec) -> Mask:
    """The contact of a truth; where none is stored, the indentation beyond the sensor's smallest.

    Public sets store the overlap of object and gel, which is 0 outside the contact.
    """
    if truth.contact is not None:
        return truth.contact
    assert truth.indentation_mm is not None
    return freeze(np.nan_to_num(truth.indentation_mm) > sensor.limits.contact_min_mm)


@lru_cache(maxsize=32)
def _open(of: RecordingSource) -> tuple[Stream, SensorSpec]:
    recording = open_recording(Path(of.path), sensor=of.sensor, reference=Path(of.reference) if of.reference else None)
    stream = recording.stream(of.stream or of.sensor)
    if not (of.sensor or stream.sensor):
        raise FileProblem("the recording does not name its sensor; name it in the recipe", of.path)
    return stream, load_sensor(of.sensor or stream.sensor)


@derive_once
def _list_frames_with_truth(recording: RecordingSource) -> tuple[int, ...]:
    stream, _ = _open(recording)
    truths = (stream.truth(index) for index in range(stream.n_frames))
    return tuple(index for index, truth in enumerate(truths) if truth is not None and truth.indentation_mm is not None)


@lru_cache(maxsize=8)
def _load_balls(recording: RecordingSource) -> tuple[LabelledTouch, ...]:
    """The presses of a folder in which the ball is detected."""
    stream, source = _open(recording)
    frames = [stream.frame(index) for index in range(stream.n_frames)]
    reference = frames[0].reference if frames else None
    if reference is None or reference.ndim != 3 or source.gel is None:
        raise FileProblem("presses of a ball need images of a gel and a reference image", recording.path)
    calibration = calibrate_balls(
        [cast("Image", frame.image) for frame in frames], cast("Image", reference), source, recording.diameter_mm
    )
    touches: list[LabelledTouch] = []
    for fit in calibration.presses:
        if fit.used:
            frame = frames[fit.index]
            estimated = estimate_depth(frame, source, calibration, DepthParams()).indentation_mm
            surface, contact = simulate_ball_press(source, estimated, 0.5 * recording.diameter_mm, fit)
            touches.append(LabelledTouch(frame=frame, source=source, indentation_mm=surface, contact=contact))
    return tuple(touches)


def simulate_ball_press(
    source: SensorSpec, estimated_mm: Floats, radius_mm: float, fit: BallFit
) -> tuple[Floats, Mask]:
    """Indentation in mm and contact (rows, cols) of a ball, pressed until it protrudes as far as in `estimated_mm`."""
    assert source.gel is not None
    y, x = np.ogrid[: estimated_mm.shape[0], : estimated_mm.shape[1]]
    r_sq = (x - fit.x_px) ** 2 + (y - fit.y_px) ** 2
    middle, around = (r_sq < (share * fit.radius_px) ** 2 for share in (1.0, _AROUND[1]))
    around &= r_sq > (_AROUND[0] * fit.radius_px) ** 2
    reach = (-radius_mm + np.sqrt(np.maximum(radius_mm**2 - r_sq * source.pixel_mm**2, 0.0))).astype(np.float32)

    def measure_protrusion(surface: Floats, step: int) -> float:
        inside, ring = (surface[mask[::step, ::step]] for mask in (middle, around))
        return float(inside.mean()) - (float(ring.mean()) if ring.size else 0.0)

    protrusion, low, high = measure_protrusion(estimated_mm, 1), 0.0, min(radius_mm, source.gel.thickness_mm)
    for _ in range(_N_BISECTIONS):
        deep = np.float32(0.5 * (low + high))
        trial = gel.press_gel(source.gel, _COARSE * source.pixel_mm, reach[::_COARSE, ::_COARSE] + deep)
        too_shallow = measure_protrusion(trial.indentation_mm, _COARSE) < protrusion
        low, high = (float(deep), high) if too_shallow else (low, float(deep))
    press = gel.press_gel(source.gel, source.pixel_mm, reach + np.float32(0.5 * (low + high)))
    return freeze(press.indentation_mm.astype(np.float32)), freeze(press.contact)
