"""Rollouts as recordings: the frames of all sensors, and in the group `rollout` what the robot did.

    /rollout                 summary (JSON: outcome, decisions, error attribution), key (digest of the plan)
        time                 (n,) "s"
        world_from_object    (n, 4, 4) "mm"
        world_from_hand      (n, 4, 4) "mm"
        commanded            (n, 4, 4) "mm", the hand as commanded
        force                (n, 3) "N" on the object, world axes

Frame `i` of the streams is the moment of decision `i`.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.recordings.hdf5_writer import RecordingWriter
from pipeline.simulation.recorder import BUBBLE_STEP_MM
from pipeline.tasks.task import Rollout

GROUP = "rollout"
_DIGITS = 6  # of numbers in a summary: equal on machines whose last bits differ


def summarise(rollout: Rollout) -> dict[str, object]:
    """What a table and `--json` show of a rollout."""
    return _round({
        "case": rollout.case, "trial": rollout.index, "touch": rollout.touch, "tolerance_mm": rollout.tolerance_mm,
        "succeeds": rollout.succeeds, "cause": rollout.cause, "measures": dict(rollout.measures),
        "decisions": [asdict(decision) for decision in rollout.decisions],
    })  # fmt: skip


def write_rollout(rollout: Rollout, path: Path, key: str) -> None:
    """Write a rollout; raises FileProblem where nothing can be written."""
    ticks = rollout.ticks
    with RecordingWriter(
        path, object_mesh=rollout.mesh, pairings=rollout.pairings, notes=(f"rollout: {rollout.cause}",),
        coding="row differences", depth_step_mm=BUBBLE_STEP_MM,
    ) as writer:  # fmt: skip
        for stream, frame, truth in rollout.frames:
            writer.append(stream, frame, truth)
        writer.write_group(
            GROUP,
            {
                "time": (np.array([tick.time_s for tick in ticks]), "s"),
                "world_from_object": (np.array([tick.world_from_object for tick in ticks]), "mm"),
                "world_from_hand": (np.array([tick.world_from_hand for tick in ticks]), "mm"),
                "commanded": (np.array([tick.commanded for tick in ticks]), "mm"),
                "force": (np.array([tick.force_n for tick in ticks]), "N"),
            },
            {"summary": json.dumps(summarise(rollout)), "key": key},
        )


def read_summary(path: Path, key: str) -> Mapping[str, Any] | None:
    """The summary of a rollout that was run with this key; None for another one or a file that cannot be read."""
    import h5py

    with contextlib.suppress(Exception), h5py.File(path, "r") as file:  # one that cannot be read is written again
        attributes = file[GROUP].attrs
        if attributes["key"] == key:
            return json.loads(str(attributes["summary"]))
    return None


def _round(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, _DIGITS) + 0.0
    if isinstance(value, Mapping):
        return {key: _round(one) for key, one in value.items()}
    return [_round(one) for one in value] if isinstance(value, list | tuple) else value
