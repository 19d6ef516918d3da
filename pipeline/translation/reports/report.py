"""Files of a translated frame: arrays, a sheet, and its lines in the report.

Frames that an earlier run completed are recognised by a key of everything they depend on.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline import __version__
from pipeline.core.digests import compute_digest, compute_fingerprint
from pipeline.core.errors import StageWarning
from pipeline.core.files import write_arrays, write_folder, write_json
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import Camera
from pipeline.core.graph import StageResult, StageResults
from pipeline.core.values.frames import TactileFrame
from pipeline.stages.depth.contact_force import FORCE
from pipeline.stages.metrics.stage_metrics import METRICS
from pipeline.stages.stage import TRUTH, GroundTruth
from pipeline.translation.translate import Translation
from pipeline.translation.translated_frame import FrameReport

FRAME_FILES = ("frame.json", "stages.npz", "sheet.png")  # of one frame's folder


def collect_stage_arrays(frame: TactileFrame, results: StageResults) -> dict[str, NDArray[Any]]:
    """Return every array of every stage as `stage.field`; a camera becomes its K (3, 3)."""
    arrays: dict[str, NDArray[Any]] = {"source.image": frame.shown_image}
    if frame.reference is not None:
        arrays["source.reference"] = frame.reference
    for name, result in results.items():
        arrays |= collect_value_arrays(name, result.output)
        if result.method is not None and result.method.name == TRUTH:
            arrays[f"{name}.is_truth"] = np.asarray(True)
        for kept in ("steps", "alternatives"):
            poses = [
                getattr(one, "sensor_from_object", one) for one in getattr(result.output, kept, ())
            ]
            if poses:
                arrays[f"{name}.{kept}"] = np.stack(poses)
    return arrays


def collect_value_arrays(name: str, output: Any) -> dict[str, NDArray[Any]]:
    """Return every array, number and camera of one stage's value as `name.field`."""
    arrays: dict[str, NDArray[Any]] = {}
    for f in fields(output):
        value = getattr(output, f.name)
        if isinstance(value, np.ndarray):
            arrays[f"{name}.{f.name}"] = value
        elif isinstance(value, Camera):
            arrays[f"{name}.{f.name}"] = value.matrix
        elif isinstance(value, (bool, int, float)):
            arrays[f"{name}.{f.name}"] = np.asarray(value)
    return arrays


def frame_folder(out: Path, index: int) -> Path:
    """Return the folder of frame `index` under `out`."""
    return out / f"frame_{index:04d}"


def write_frame(
    out: Path,
    frame: TactileFrame,
    report: FrameReport,
    translation: Translation,
    key: str = "",
    *,
    sheet: bool = True,
) -> Path:
    """Write `frame_NNNN/` with stages.npz, sheet.png and frame.json under `out`.

    Returns that folder.

    A later run recognises the finished frame by its `key`; without one it is made again. Without
    `sheet` there is no sheet.png, whose drawing takes longer than all stages.
    """
    folder = frame_folder(out, report.index)

    def fill(part: Path) -> None:
        write_arrays(part / "stages.npz", collect_stage_arrays(frame, report.results))
        if sheet:
            from pipeline.translation.reports.sheet import write_sheet  # imports matplotlib

            write_sheet(part / "sheet.png", frame, report, translation)
        digests = {path.name: compute_fingerprint(path) for path in sorted(part.iterdir())}
        write_json(part / "frame.json", {"key": key or None, "files": digests, **_to_json(report)})

    write_folder(folder, fill, FRAME_FILES)
    return folder


def write_report(out: Path, translation: Translation, frames: Sequence[FrameReport]) -> Path:
    """Write `report.json` under `out`; returns its path."""
    request = translation.request
    path = out / "report.json"
    write_json(
        path,
        {
            "route": translation.route.name,
            "methods": {method.stage: method.name for method in translation.methods},
            "recording": str(request.recording),
            "source": translation.source.name,
            "target": translation.target.name,
            "notes": translation.notes,
            "metrics": {
                name: asdict(METRICS[name.partition(".")[2]])
                for name in sorted({name for frame in frames for name in frame.metrics})
                if name.partition(".")[2] in METRICS
            },
            "frames": [_to_json(f) for f in frames],
        },
    )
    return path


def _to_json(frame: FrameReport) -> dict[str, object]:
    stages = [
        {
            "name": r.name,
            "ms": round(r.ms, 3),
            "skipped": r.state == "skipped",
            "state": r.state,
            "notes": r.notes,
            "warnings": r.warnings,
            "fallback": r.fallback,
        }
        for r in frame.results.values()
    ]
    lines: dict[str, object] = {
        "index": frame.index,
        "stages": stages,
        "metrics": dict(frame.metrics),
    }
    if frame.problem:
        lines["problem"] = frame.problem
    return lines


@frozen
class FinishedFrame:
    """A frame that is complete on disk."""

    report: FrameReport  # without its arrays
    key: str


def compute_frame_key(
    translation: Translation,
    frame: TactileFrame,
    truth: GroundTruth,
    before: str,
    *,
    with_force: bool,
) -> str:
    """Return the digest of everything a frame's results depend on: contents, truth, settings,
    versions, the key of the frame `before` that it follows ("" = none).
    """
    return compute_digest(
        (
            __version__,
            *((m.stage, m.name, m.version) for m in translation.methods),
            repr(translation.params),
            dict(translation.read_inputs(frame)),
            truth.source_truth,
            truth.target_observation and (truth.target_observation, truth.target_truth),
            translation.symmetry,
            translation.force_scale,
            with_force and FORCE.version,
            before,
        )
    )


def load_finished_frame(
    out: Path, index: int, key: str, *, sheet: bool = True
) -> FinishedFrame | None:
    """Return frame `index` of an earlier run under `out`.

    None if it is incomplete, lacks a `sheet`, or was made from other inputs.
    """
    folder = frame_folder(out, index)
    with contextlib.suppress(Exception):  # a frame that cannot be read is made again
        record = json.loads((folder / "frame.json").read_text(encoding="utf-8"))
        digests = {name: compute_fingerprint(folder / name) for name in record["files"]}
        complete = record["files"] == digests and (not sheet or FRAME_FILES[-1] in digests)
        if record["key"] == key and complete:
            return FinishedFrame(report=_report(record), key=key)
    return None


def _report(record: Mapping[str, Any]) -> FrameReport:
    results = {
        s["name"]: StageResult(
            name=s["name"],
            method=None,
            output=None,
            state=s["state"],
            ms=s["ms"],
            notes=tuple(StageWarning(n) if n in s["warnings"] else n for n in s["notes"]),
            digest="",
            fallback=s["fallback"],
        )
        for s in record["stages"]
    }
    metrics = {
        name: float("nan") if value is None else float(value)
        for name, value in record["metrics"].items()
    }
    return FrameReport(index=record["index"], results=results, metrics=metrics)
