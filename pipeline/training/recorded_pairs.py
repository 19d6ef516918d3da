"""Training pairs of touch to touch from a user's recording of both sensors.

The condition is computed as in use. The target's touch is the recording's truth, or the depth estimated from its frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from pipeline.base.arrays import Floats, Mask
from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.recordings import open_recording
from pipeline.sensors import alignment as alignments
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.depth import photometric as depth
from pipeline.stages.touch import t2t
from pipeline.stages.touch.depth_condition import make_working_sensor
from pipeline.stages.touch.residual_render import resample_to_grid
from pipeline.values.frames import Stream


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingPair:
    """A pair on the target's working grid."""

    condition: Floats  # (channels, rows, cols), see `stages.touch.image_condition`
    indentation_mm: Floats  # (rows, cols) of the target
    contact: Mask  # (rows, cols)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedPairs:
    """The pairs of a recording."""

    pairs: tuple[TrainingPair, ...]  # in its order
    notes: tuple[str, ...]  # what was assumed or left out


@lru_cache(maxsize=4)
def load_recorded_pairs(path: str, source_name: str, target_name: str) -> RecordedPairs:
    """Every moment of a recording at which both sensors are touched.

    Raises FileProblem where there is none, SettingProblem where one of the sensors has no stream.
    """
    recording, source, target = open_recording(Path(path)), load_sensor(source_name), load_sensor(target_name)
    try:
        one, other = recording.stream_of_sensor(source_name), recording.stream_of_sensor(target_name)
        if one is None or other is None:
            raise SettingProblem(f"{path!r} holds no pairs of {source.title} and {target.title}")
        target_from_source = recording.target_from_source(one.name, other.name)
        alignment = alignments.resolve_alignment(source, target, target_from_source)
        n = min(one.n_frames, other.n_frames)
        pairs = [_make_pair(one, other, index, source, target, alignment) for index in range(n)]
        no_reference = [s.title for s, of in ((source, one), (target, other)) if n and of.frame(0).reference is None]
    finally:
        recording.close()
    touched = tuple(pair for pair in pairs if pair is not None)
    if not touched:
        raise FileProblem("both sensors are touched at no moment of this recording", path)
    notes = {
        f"{source.title} has {one.n_frames} frames, {target.title} {other.n_frames}: the first {n} of each are paired "
        "in order": one.n_frames != other.n_frames,
        "the recording has no target_from_source: the sensors' descriptions are used": target_from_source is None,
        f"the recording has no reference image of {' and '.join(no_reference)}: the nominal one is used": no_reference,
        f"{n - len(touched)} of {n} moments are left out, where not both sensors are touched": len(touched) < n,
    }
    return RecordedPairs(pairs=touched, notes=tuple(note for note, holds in notes.items() if holds))


def _make_pair(
    one: Stream, other: Stream, index: int, source: SensorSpec, target: SensorSpec, alignment: Alignment
) -> TrainingPair | None:
    """The pair of a moment; None where one of the sensors is untouched."""
    frame, target_frame, truth = one.frame(index), other.frame(index), other.truth(index)
    if depth.skip_without_contact(frame, source, None, depth.DepthParams()) is not None:
        return None
    if truth is not None and truth.indentation_mm is not None and truth.contact is not None:
        touch, contact = truth.indentation_mm, truth.contact
    else:
        if depth.skip_without_contact(target_frame, target, None, depth.DepthParams()) is not None:
            return None
        estimate = depth.estimate_depth(target_frame, target, None, depth.DepthParams())
        touch, contact = np.nan_to_num(estimate.indentation_mm), estimate.contact
    if not contact.any():
        return None
    shape = make_working_sensor(target).camera.shape
    return TrainingPair(
        condition=t2t.build_condition(frame, source, alignment, target),
        indentation_mm=resample_to_grid(touch, shape), contact=resample_to_grid(contact, shape) > 0.5,
    )  # fmt: skip
