"""`tactoscope translate`: frame by frame, each one whole on disk before the next begins."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from pipeline.base.errors import SettingProblem, TouchError
from pipeline.base.progress import SILENT
from pipeline.base.progress import Progress as StageProgress
from pipeline.cli.stopping import stoppable
from pipeline.engine.graph import Graph
from pipeline.evaluation.metrics import frame_metrics
from pipeline.reporting.frame_report import FrameReport
from pipeline.reporting.report import write_frame, write_report
from pipeline.translation import routes
from pipeline.translation.translate import Request, Translation, new_graph, open_translation
from pipeline.values.results import DepthMap, ObjectPose


def translate_frames(
    request: Request, out: Path, frame: int | None, every: bool, settings: Sequence[str], *, follow: bool = False
) -> int:
    """Translate and write; returns 0, or 2 if some frame could not be translated (its sentence is in the report)."""
    if frame is not None and every:
        raise SettingProblem("give either --frame or --all, not both")
    if follow and not every:
        raise SettingProblem("--follow goes from touch to touch; give it with --all")
    params: Mapping[str, object] = routes.default_params()
    for assignment in settings:
        params = routes.with_setting(params, assignment)
    console = Console(stderr=True)
    translation = open_translation(request)
    for note in translation.notes:
        console.print(f"note: {note}", style="dim", highlight=False)
    graph = new_graph()
    indices = range(translation.n_frames) if every else [_chosen(translation, graph, params, frame)]
    reports: list[FrameReport] = []
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    try:
        with stoppable() as work, Progress(*columns, console=console, transient=True) as bar:
            task = bar.add_task("translating", total=len(indices))
            for index in indices:
                bar.update(task, description=f"frame {index}")
                work.step(0.0, "")
                before = _pose_of(reports) if follow else None
                reports.append(_one(translation, graph, params, index, out, before, work))
                bar.advance(task)
    finally:  # also on Ctrl-C: what is finished is whole and listed
        if reports:
            write_report(out, translation, reports)
    show_table(reports)
    failed = [r for r in reports if r.problem]
    for report in failed:
        sys.stderr.write(f"tactoscope: frame {report.index}: {report.problem}\n")
    print_line(f"{len(reports) - len(failed)} of {len(reports)} frames written to {os.fspath(out)}")
    return 2 if failed else 0


def work_out(
    translation: Translation,
    graph: Graph,
    params: Mapping[str, object],
    index: int,
    previous: ObjectPose | None = None,
    progress: StageProgress = SILENT,
) -> FrameReport:
    """All stages of one frame and its figures; a damaged frame gives a report with its problem."""
    try:
        results = graph.evaluate(translation.stages, translation.inputs(index, previous), params, progress)
        metrics = frame_metrics(
            results, translation.truth_of_source(index), translation.truth_of_target(index), translation.mesh,
            translation.symmetry,
        )  # fmt: skip
    except TouchError as error:
        return FrameReport(index=index, results={}, metrics={}, problem=str(error))
    return FrameReport(index=index, results=results, metrics=metrics)


def show_table(reports: Sequence[FrameReport]) -> None:
    """Print stage, median and largest ms, how often skipped, and the error against truth."""
    table = Table("stage", "median ms", "largest ms", "skipped", "error against truth", title=None)
    done = [r for r in reports if r.results]
    names = list(done[0].results) if done else []
    for name in names:
        ms = sorted(r.results[name].ms for r in done)
        skipped = sum(r.results[name].state == "skipped" for r in done)
        table.add_row(
            name, f"{ms[len(ms) // 2]:.2f}", f"{ms[-1]:.2f}", f"{skipped} of {len(done)}", _errors(name, done)
        )
    Console().print(table)


def print_line(text: str) -> None:
    """One line on stdout, without wrapping or colours."""
    Console(soft_wrap=True, highlight=False).print(text, markup=False)


def _one(
    translation: Translation,
    graph: Graph,
    params: Mapping[str, object],
    index: int,
    out: Path,
    previous: ObjectPose | None,
    progress: StageProgress,
) -> FrameReport:
    report = work_out(translation, graph, params, index, previous, progress)
    if not report.problem:
        write_frame(out, translation.stream.frame(index), report, translation)
    return report


def _pose_of(reports: Sequence[FrameReport]) -> ObjectPose | None:
    """The pose of the last frame, None where it had none: across a gap nothing is followed."""
    result = reports[-1].results.get("pose") if reports else None
    output = None if result is None else result.output
    return output if isinstance(output, ObjectPose) and output.sensor_from_object is not None else None


def _chosen(translation: Translation, graph: Graph, params: Mapping[str, object], frame: int | None) -> int:
    """The frame asked for, or the first one with a contact."""
    if frame is not None:
        return translation.checked(frame)
    for index in range(translation.n_frames):
        depth = graph.evaluate(["depth"], translation.inputs(index), params)["depth"].output
        if isinstance(depth, DepthMap) and depth.contact.any():
            return index
    return 0


def _errors(name: str, reports: Sequence[FrameReport]) -> str:
    """Median of every figure of a stage."""
    keys = sorted({key for r in reports for key in r.metrics if key.startswith(f"{name}.")})
    parts: list[str] = []
    for key in keys:
        values = sorted(r.metrics[key] for r in reports if key in r.metrics and r.metrics[key] == r.metrics[key])
        if values:
            parts.append(f"{key.partition('.')[2]} {values[len(values) // 2]:.3g}")
    return ", ".join(parts) or "no truth known"
