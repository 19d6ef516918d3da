"""Where a frame of a sequence starts: at the pose and the membrane of the frame before."""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.core.frozen import frozen
from pipeline.core.graph import StageResult
from pipeline.core.values.results import GeneratedTouch, ObjectPose, SealedMembrane

_MAX_GAP_S = 0.5  # between frames; after a longer one nothing is close to what it was


@frozen
class Start:
    """What a frame starts at; None = from rest, or by a search."""

    pose: ObjectPose | None = None
    membrane: SealedMembrane | None = None  # of the generated touch


FROM_REST = Start()


def get_start(results: Mapping[str, StageResult]) -> Start:
    """Where the next frame starts after these results."""
    outputs = {name: result.output for name, result in results.items()}
    pose, touch = outputs.get("pose"), outputs.get("touch")
    is_known = isinstance(pose, ObjectPose) and pose.sensor_from_object is not None
    return Start(
        pose=pose if is_known else None,
        membrane=touch.pressed if isinstance(touch, GeneratedTouch) else None,
    )


def is_close(before_s: float, time_s: float) -> bool:
    """Whether a frame is close in time to the one before; not where a time is unknown (NaN)."""
    return abs(time_s - before_s) <= _MAX_GAP_S
