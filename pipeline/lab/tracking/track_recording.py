"""Track the membrane of one stage through a recording, for the command line and the window
alike.
"""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace

from pipeline.core.arrays import Doubles
from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.results import DepthMap
from pipeline.lab.tracking.track import compute_error, make_record, make_row, track_frames
from pipeline.lab.tracking.track_record import TRACKED_STAGES, TrackRecord, TrackRow
from pipeline.translation.translate import Translation


def track_recording(
    translation: Translation,
    stage: str,
    indices: Sequence[int],
    progress: Progress = SILENT,
    on_row: Callable[[TrackRow], None] | None = None,
) -> TrackRecord:
    """Follow the object through the frames `indices` by the depth of a stage.

    `on_row` receives every frame at once.

    Rows of the result may differ from those that `on_row` received: closed loops move them. Frames
    that cannot be read count as lost; raises FileProblem where none can.
    """
    if stage not in TRACKED_STAGES:
        raise SettingProblem(
            f"the membrane of {stage!r} is not tracked; choose one of {', '.join(TRACKED_STAGES)}"
        )
    problems = dict[int, FileProblem]()

    def read_depth(index: int) -> DepthMap | None:
        try:
            frame = translation.stream.frame(index)
        except FileProblem as error:
            problems[index] = error
            return None
        return translation.evaluate(frame, [stage])[stage].output

    track = track_frames(
        indices,
        read_depth,
        progress,
        None if on_row is None else lambda frame, keys: on_row(make_row(frame, keys)),
    )
    if problems and len(problems) == len(indices):
        raise problems[indices[0]]
    record = make_record(
        track, stage, compute_error(track, lambda index: _read_pose(translation, stage, index))
    )
    return replace(
        record, problems=tuple(f"frame {index}: {problem}" for index, problem in problems.items())
    )


def _read_pose(translation: Translation, stage: str, index: int) -> Doubles | None:
    """The true pose `sensor_from_object` (4, 4) in the frame of the followed sensor.

    None where unknown or damaged.
    """
    truth = None
    with contextlib.suppress(FileProblem):
        if stage == "touch_depth":
            other = translation.read_target_observation(index)
            truth = None if other is None else other[1]
        else:
            truth = translation.read_source_truth(index)
    return None if truth is None else truth.sensor_from_object
