"""Frames that an earlier run left whole: what they came out of is kept beside them, so that nothing is done twice."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline import __version__
from pipeline.base.arrays import freeze
from pipeline.base.stage_warnings import StageWarning
from pipeline.engine.digests import compute_digest
from pipeline.engine.graph import StageResult
from pipeline.reporting.frame_report import FrameReport
from pipeline.reporting.report import frame_folder
from pipeline.translation.translate import Translation
from pipeline.values.results import ObjectPose


@dataclass(frozen=True, slots=True, kw_only=True)
class FinishedFrame:
    """A frame that is whole on disk."""

    report: FrameReport  # without its arrays
    key: str
    pose: ObjectPose | None = None  # what the next touch of a sequence begins with; None = it has none


def compute_frame_key(
    translation: Translation, params: Mapping[str, object], index: int, before: FinishedFrame | None
) -> str:
    """Digest of all that a frame's results come from: its contents, truth, settings, versions, and the frame followed.

    Raises FileProblem if the frame is damaged.
    """
    return compute_digest(
        (
            __version__,
            *((m.stage, m.name, m.version) for m in translation.methods),
            repr(params),
            dict(translation.read_inputs(index)),
            translation.read_source_truth(index),
            translation.read_target_observation(index),
            translation.symmetry,
            before.key if before is not None and before.pose is not None else "",
        )
    )


def load_finished_frame(out: Path, index: int, key: str) -> FinishedFrame | None:
    """What an earlier run left of frame `index` under `out`; None if it is not whole or came from something else."""
    folder = frame_folder(out, index)
    with contextlib.suppress(Exception):  # whatever is wrong with a frame that can be made again is no news to anybody
        told = json.loads((folder / "frame.json").read_text(encoding="utf-8"))
        if told["key"] == key and (folder / "sheet.png").stat().st_size:
            return FinishedFrame(report=_report(told), key=key, pose=_pose(folder / "stages.npz"))
    return None


def _report(record: Mapping[str, Any]) -> FrameReport:
    results = {
        s["name"]: StageResult(name=s["name"], method=None, output=None, state=s["state"], ms=s["ms"],
                               notes=tuple(StageWarning(n) if n in s["warnings"] else n for n in s["notes"]), digest="",
                               fallback=s["fallback"])
        for s in record["stages"]
    }  # fmt: skip
    metrics = {name: float("nan") if value is None else float(value) for name, value in record["metrics"].items()}
    return FrameReport(index=record["index"], results=results, metrics=metrics)


def _pose(path: Path) -> ObjectPose | None:
    """The pose among a frame's arrays; raises what a damaged file does."""
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        if "pose.sensor_from_object" not in arrays:
            return None
        others = arrays.get("pose.alternatives", ())
        return ObjectPose(
            sensor_from_object=freeze(arrays["pose.sensor_from_object"]), covariance=None, observable=None, weak_directions=(),
            rmse_mm=float(arrays["pose.rmse_mm"]), fitness=float(arrays["pose.fitness"]),
            scene_mm=freeze(arrays["pose.scene_mm"]), source_index=freeze(arrays["pose.source_index"]),
            alternatives=tuple(freeze(np.array(other)) for other in others),
        )  # fmt: skip
