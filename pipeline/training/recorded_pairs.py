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
from pipeline.sensors.spec import SensorSpec, sensor
from pipeline.stages.depth import stage as depth
from pipeline.stages.generate import picture_to_touch
from pipeline.stages.generate.corrected import on_grid
from pipeline.stages.generate.residual_input import working
from pipeline.training.drawn_pairs import Drawn
from pipeline.values.frames import Stream

_HALF = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """What a recording holds to learn from."""

    pairs: tuple[Drawn, ...]  # in its order
    notes: tuple[str, ...]  # what was assumed or left out


@lru_cache(maxsize=4)
def recorded_pairs(path: str, source_name: str, target_name: str) -> Recorded:
    """Every moment of a recording at which both sensors were touched.

    Raises FileProblem where there is none, SettingProblem where one of the two took no part.
    """
    recording, source, target = open_recording(Path(path)), sensor(source_name), sensor(target_name)
    try:
        one, other = recording.stream_of_sensor(source_name), recording.stream_of_sensor(target_name)
        if one is None or other is None:
            raise SettingProblem(f"{path!r} holds no pairs of {source.title} and {target.title}")
        known = recording.target_from_source(one.name, other.name)
        stand, n = alignments.between(source, target, known), min(one.n_frames, other.n_frames)
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
    return Recorded(pairs=found, notes=tuple(note for note, holds in notes.items() if holds))


def _pair(
    one: Stream, other: Stream, index: int, source: SensorSpec, target: SensorSpec, stand: Alignment
) -> Drawn | None:
    frame, own, truth = one.frame(index), other.frame(index), other.truth(index)
    if depth.untouched(frame, source, None, depth.DepthParams()) is not None:
        return None
    if truth is not None and truth.indentation_mm is not None and truth.contact is not None:
        touch, contact = truth.indentation_mm, truth.contact
    else:
        if depth.untouched(own, target, None, depth.DepthParams()) is not None:
            return None
        read = depth.depth(own, target, None, depth.DepthParams())
        touch, contact = np.nan_to_num(read.indentation_mm), read.contact
    if not contact.any():
        return None
    shape = working(target).camera.shape
    return Drawn(
        shown=picture_to_touch.condition(frame, source, stand, target), touch_mm=on_grid(touch, shape),
        contact=on_grid(contact, shape) > _HALF,
    )  # fmt: skip
