"""A user's own recording of both sensors as pairs to learn touch to touch from.

The source's frame is drawn as it will be in use; of the target counts the recording's truth, or what its own reading
says where it has none.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.recordings import open_recording
from pipeline.sensors import alignment as alignments
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.depth import photometric as depth
from pipeline.stages.touch import t2t
from pipeline.stages.touch.depth_condition import make_working_sensor
from pipeline.stages.touch.residual_render import resample_to_grid
from pipeline.training.pair_files import TrainingPair
from pipeline.values.frames import Stream

_HALF = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedPairs:
    """What a recording holds to learn from."""

    pairs: tuple[TrainingPair, ...]  # in its order
    notes: tuple[str, ...]  # what was assumed or left out


@lru_cache(maxsize=4)
def load_recorded_pairs(path: str, source_name: str, target_name: str) -> RecordedPairs:
    """Every moment of a recording at which both sensors were touched.

    Raises FileProblem where there is none, SettingProblem where one of the two took no part.
    """
    recording, source, target = open_recording(Path(path)), load_sensor(source_name), load_sensor(target_name)
    try:
        one, other = recording.stream_of_sensor(source_name), recording.stream_of_sensor(target_name)
        if one is None or other is None:
            raise SettingProblem(f"{path!r} holds no pairs of {source.title} and {target.title}")
        known = recording.target_from_source(one.name, other.name)
        stand, n = alignments.resolve_alignment(source, target, known), min(one.n_frames, other.n_frames)
        made = [_pair(one, other, index, source, target, stand) for index in range(n)]
        still = [s.title for s, of in ((source, one), (target, other)) if n and of.frame(0).reference is None]
    finally:
        recording.close()
    found = tuple(pair for pair in made if pair is not None)
    if not found:
        raise FileProblem("both sensors are touched at no moment of this recording", path)
    notes = {
        f"{source.title} has {one.n_frames} frames, {target.title} {other.n_frames}: the first {n} of each are taken "
        "as the same moments, in this order": one.n_frames != other.n_frames,
        "the recording does not say how its sensors stand to each other: as their descriptions say": known is None,
        f"no untouched reading of {' and '.join(still)} is in the recording: as described, not this unit's": still,
        f"{n - len(found)} of {n} moments are left out, where not both are touched": len(found) < n,
    }
    return RecordedPairs(pairs=found, notes=tuple(note for note, holds in notes.items() if holds))


def _pair(
    one: Stream, other: Stream, index: int, source: SensorSpec, target: SensorSpec, stand: Alignment
) -> TrainingPair | None:
    frame, own, truth = one.frame(index), other.frame(index), other.truth(index)
    if depth.skip_without_contact(frame, source, None, depth.DepthParams()) is not None:
        return None
    if truth is not None and truth.indentation_mm is not None and truth.contact is not None:
        touch, contact = truth.indentation_mm, truth.contact
    else:
        if depth.skip_without_contact(own, target, None, depth.DepthParams()) is not None:
            return None
        read = depth.estimate_depth(own, target, None, depth.DepthParams())
        touch, contact = np.nan_to_num(read.indentation_mm), read.contact
    if not contact.any():
        return None
    shape = make_working_sensor(target).camera.shape
    return TrainingPair(
        condition=t2t.build_condition(frame, source, stand, target), indentation_mm=resample_to_grid(touch, shape),
        contact=resample_to_grid(contact, shape) > _HALF,
    )  # fmt: skip
