"""What a translated frame leaves behind: arrays, a sheet, and its lines in the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.files import write_arrays, write_folder, write_json
from pipeline.engine.graph import StageResult
from pipeline.geometry.camera import Camera
from pipeline.reporting.frame_report import FrameReport
from pipeline.translation.translate import Translation
from pipeline.values.frames import TactileFrame


def stage_arrays(frame: TactileFrame, results: Mapping[str, StageResult]) -> dict[str, NDArray[Any]]:
    """Every array of every stage under `stage.field`; a camera becomes its K (3, 3)."""
    arrays: dict[str, NDArray[Any]] = {"source.image": frame.image}
    if frame.reference is not None:
        arrays["source.reference"] = frame.reference
    for name, result in results.items():
        for f in fields(result.output):
            value = getattr(result.output, f.name)
            if isinstance(value, np.ndarray):
                arrays[f"{name}.{f.name}"] = value
            elif isinstance(value, Camera):
                arrays[f"{name}.{f.name}"] = value.matrix
            elif isinstance(value, (bool, int, float)):
                arrays[f"{name}.{f.name}"] = np.asarray(value)
    pose = results.get("pose")
    if pose is not None and pose.output.steps:
        arrays["pose.steps"] = np.stack([step.sensor_from_object for step in pose.output.steps])
    return arrays


def write_frame(out: Path, frame: TactileFrame, report: FrameReport, translation: Translation) -> Path:
    """Write `frame_NNNN/` with stages.npz and sheet.png under `out`; returns that folder."""
    from pipeline.reporting.sheet import write_sheet  # matplotlib only where a sheet is drawn

    folder = out / f"frame_{report.index:04d}"

    def fill(part: Path) -> None:
        write_arrays(part / "stages.npz", stage_arrays(frame, report.results))
        write_sheet(part / "sheet.png", frame, report, translation)

    write_folder(folder, fill)
    return folder


def write_report(out: Path, translation: Translation, frames: Sequence[FrameReport]) -> Path:
    """Write `report.json` under `out`; returns its path."""
    request = translation.request
    path = out / "report.json"
    write_json(
        path,
        {
            "route": request.route,
            "recording": str(request.recording),
            "source": translation.source.name,
            "target": translation.target.name,
            "notes": translation.notes,
            "frames": [_frame_lines(f) for f in frames],
        },
    )
    return path


def _frame_lines(frame: FrameReport) -> dict[str, object]:
    stages = [
        {"name": r.name, "ms": round(r.ms, 3), "skipped": r.state == "skipped", "state": r.state, "notes": r.notes}
        for r in frame.results.values()
    ]
    lines: dict[str, object] = {"index": frame.index, "stages": stages, "metrics": dict(frame.metrics)}
    if frame.problem:
        lines["problem"] = frame.problem
    return lines
