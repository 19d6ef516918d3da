"""Frames that an earlier run completed, recognised by a key of everything they depend on."""

import contextlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline import __version__
from pipeline.base.arrays import freeze
from pipeline.base.errors import StageWarning
from pipeline.base.fingerprints import compute_fingerprint
from pipeline.engine.digests import compute_digest
from pipeline.engine.graph import StageResult
from pipeline.reporting.frame_report import FrameReport
from pipeline.reporting.report import FRAME_FILES, frame_folder
from pipeline.translation.translate import Translation
from pipeline.values.results import ObjectPose


@dataclass(frozen=True, slots=True, kw_only=True)
class FinishedFrame:
    """A frame that is complete on disk."""

    report: FrameReport  # without its arrays
    key: str
    pose: ObjectPose | None = None  # initial pose of the next frame of a sequence; None = none


def compute_frame_key(
    translation: Translation,
    params: Mapping[str, object],
    index: int,
    before: FinishedFrame | None,
    *,
    with_force: bool,
) -> str:
    """Return the digest of everything a frame's results depend on: contents, truth, settings, versions, previous frame.

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
            translation.force_scale,
            with_force,
            before.key if before is not None and before.pose is not None else "",
        )
    )


def load_finished_frame(out: Path, index: int, key: str) -> FinishedFrame | None:
    """Return frame `index` of an earlier run under `out`; None if it is incomplete or was made from other inputs."""
    folder = frame_folder(out, index)
    with contextlib.suppress(Exception):  # a frame that cannot be read is made again
        record = json.loads((folder / "frame.json").read_text(encoding="utf-8"))
        digests = {name: compute_fingerprint(folder / name) for name in FRAME_FILES[1:]}
        if record["key"] == key and record["files"] == digests:
            return FinishedFrame(report=_report(record), key=key, pose=_pose(folder / "stages.npz"))
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
    """Return the pose among a frame's arrays; raises for a damaged file."""
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        if "pose.sensor_from_object" not in arrays:
            return None
        others = arrays.get("pose.alternatives", ())
        return ObjectPose(
            sensor_from_object=freeze(arrays["pose.sensor_from_object"]),
            covariance=None,
            observable=None,
            weak_directions=(),
            rmse_mm=float(arrays["pose.rmse_mm"]),
            fitness=float(arrays["pose.fitness"]),
            scene_mm=freeze(arrays["pose.scene_mm"]),
            source_index=freeze(arrays["pose.source_index"]),
            alternatives=tuple(freeze(np.array(other)) for other in others),
        )
