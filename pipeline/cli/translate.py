"""`tactoscope translate`: frame by frame, each one whole on disk before the next begins."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, fields, replace
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from pipeline.base import compiling, error_log
from pipeline.base.cluster import connect_cluster
from pipeline.base.errors import SettingProblem, TouchError
from pipeline.base.files import prepare_folder
from pipeline.base.progress import SILENT
from pipeline.base.progress import Progress as StageProgress
from pipeline.base.text import escape_text
from pipeline.cli.interrupts import interruptible_progress
from pipeline.cli.terminal import print_error, print_line
from pipeline.engine.cache import Cache
from pipeline.engine.graph import Graph
from pipeline.reporting.frame_report import FrameReport
from pipeline.reporting.report import write_frame, write_report
from pipeline.reporting.resume import FinishedFrame, compute_frame_key, load_finished_frame
from pipeline.translation.catalogue import with_settings
from pipeline.translation.translate import Request, Translation, open_translation
from pipeline.translation.truth_warnings import add_truth_warnings
from pipeline.values.results import ObjectPose

CACHE_BYTES = 32 * 1024 * 1024  # a few frames: what a run has passed it does not ask for again


@dataclass(frozen=True, slots=True, kw_only=True)
class _Piece:
    """A frame for a worker elsewhere, which writes it where all frames go."""

    request: Request
    settings: tuple[str, ...]
    out: Path
    index: int


def _finish(piece: _Piece) -> None:
    """Translate one frame and leave it whole on disk; one that cannot be is left to who asks for it next."""
    with closing(open_translation(piece.request)) as translation:
        graph = translation.build_graph(like=Graph((), cache=Cache(CACHE_BYTES)))
        params = with_settings(translation.methods, piece.settings)
        _one(translation, graph, params, piece.index, piece.out, None, SILENT)


def _absolute(request: Request) -> Request:
    """The same request for those who work in other folders."""
    paths = {f.name: value.resolve() for f in fields(request) if isinstance(value := getattr(request, f.name), Path)}
    weights = tuple((slot, file.resolve()) for slot, file in request.weights)
    return replace(request, weights=weights, **paths)


def translate_frames(
    request: Request,
    out: Path,
    frame: int | None,
    every: bool,
    settings: Sequence[str],
    *,
    follow: bool = False,
    scheduler: str = "",
) -> int:
    """Translate and write what an earlier run has not left whole with the same request, settings and versions.

    With a `scheduler` its workers write the frames, and what they leave is taken up here. Returns 0, 2 if some frame
    could not be translated (its sentence is in the report), 1 if one failed unforeseen.
    """
    if frame is not None and every:
        raise SettingProblem("give either --frame or --all, not both")
    if follow and not every:
        raise SettingProblem("--follow goes from touch to touch; give it with --all")
    if scheduler and (follow or not every):
        raise SettingProblem("--scheduler hands out single frames; give it with --all, and without --follow")
    console, request = Console(stderr=True), _absolute(request) if scheduler else request
    translation = open_translation(request)
    translation.check_index(0)
    params = with_settings(translation.methods, settings)
    graph = translation.build_graph(like=Graph((), cache=Cache(CACHE_BYTES)))
    with console.status("looking for a touch") as status, compiling.report_compiling(status.update):
        indices = range(translation.n_frames) if every else [_chosen(translation, graph, params, frame)]
    prepare_folder(out)
    reports: list[FrameReport] = []
    last: FinishedFrame | None = None
    n_kept = 0
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    try:
        with interruptible_progress() as work, Progress(*columns, console=console, transient=True) as bar:
            task = bar.add_task("translating", total=len(indices))
            if scheduler:
                where, said = out.resolve(), tuple(settings)
                with connect_cluster(scheduler) as elsewhere:
                    elsewhere.map(
                        _finish, [_Piece(request=request, settings=said, out=where, index=k) for k in indices], work
                    )
            for index in indices:
                bar.update(task, description=f"frame {index}")
                work.step(0.0, "")
                with compiling.report_compiling(lambda text: bar.update(task, description=text)):
                    known, last = _one(translation, graph, params, index, out, last if follow else None, work)
                reports.append(last.report)
                n_kept += known
                bar.advance(task)
    finally:  # also on Ctrl-C: what is finished is whole and listed
        translation.close()
        if reports:
            write_report(out, translation, reports)
    failed = [frame for frame in reports if frame.problem]
    for one in failed:
        print_error(f"frame {one.index}: {one.problem}" if every else one.problem)
    if len(failed) == len(reports) == 1:
        return _code(failed)  # of a recording that gave nothing nothing else is of interest
    for note in translation.notes:
        console.print(
            escape_text(f"note: {note}"), style="dim", highlight=False, markup=False, emoji=False, soft_wrap=True
        )
    print_stage_table(reports)
    for told in (*list_fallbacks(reports), *list_warnings(reports)):
        print_line(told)
    if n_kept and not scheduler:
        print_line(f"{n_kept} of them were finished by an earlier run and are kept as they are")
    print_line(f"{len(reports) - len(failed)} of {len(reports)} frames written to {os.fspath(out)}")
    return _code(failed)


def _code(failed: Sequence[FrameReport]) -> int:
    return 0 if not failed else 2 if all(frame.is_user_error for frame in failed) else 1


def print_stage_table(reports: Sequence[FrameReport]) -> None:
    """Print slot, median and largest ms, how often skipped, and the error against truth."""
    table = Table("slot", "median ms", "largest ms", "skipped", "error against truth", title=None)
    done = [r for r in reports if r.results]
    for name in done[0].results if done else ():
        ms = sorted(r.results[name].ms for r in done)
        skipped = sum(r.results[name].state == "skipped" for r in done)
        table.add_row(
            name, f"{ms[len(ms) // 2]:.2f}", f"{ms[-1]:.2f}", f"{skipped} of {len(done)}", _errors(name, done)
        )
    Console().print(table)


def list_fallbacks(reports: Sequence[FrameReport]) -> list[str]:
    """Every slot that another method filled than the one asked for, and why."""
    found = {f"{name}: {result.fallback}" for one in reports for name, result in one.results.items() if result.fallback}
    return [f"another method answered: {told}" for told in sorted(found)]


def list_warnings(reports: Sequence[FrameReport]) -> list[str]:
    """Every doubt once, at the first slot that has it, with its frames; where numbers differ, those of the first."""
    slots: dict[str, str] = {}
    frames: dict[str, dict[int, str]] = {}
    for one in reports:
        for name, result in one.results.items():
            for doubt in result.warnings:
                kind = re.sub(r"[\d.,]*\d", "", doubt)
                slots.setdefault(kind, name)
                frames.setdefault(kind, {}).setdefault(one.index, doubt)
    return [
        f"doubtful: {slots[kind]}: {next(iter(at.values()))}" + (f" ({_listed(at)})" if len(reports) > 1 else "")
        for kind, at in frames.items()
    ]


def _listed(frames_by_warning: Mapping[int, str]) -> str:
    """Frame numbers, the first few of many, and whose numbers were told where others have others."""
    few = ", ".join(str(n) for n in list(frames_by_warning)[:8])
    if len(frames_by_warning) == 1:
        return f"frame {few}"
    whose = f"; told is frame {next(iter(frames_by_warning))}" if len(set(frames_by_warning.values())) > 1 else ""
    return f"{len(frames_by_warning)} frames: {few}{', …' if len(frames_by_warning) > 8 else ''}{whose}"


def _one(
    translation: Translation,
    graph: Graph,
    params: Mapping[str, object],
    index: int,
    out: Path,
    before: FinishedFrame | None,
    progress: StageProgress,
) -> tuple[bool, FinishedFrame]:
    """A frame that is whole on disk and whether it was already; one that cannot be made has its problem instead."""
    try:
        key = compute_frame_key(translation, params, index, before)
        known = load_finished_frame(out, index, key)
        if known is not None:
            return True, known
        inputs = translation.read_inputs(index, before.pose if before else None)
        results = graph.evaluate(translation.stages, inputs, params, progress)
        facts = translation.read_ground_truth(index)
        results = {name: add_truth_warnings(result, facts) for name, result in results.items()}
        report = FrameReport(index=index, results=results, metrics=translation.compute_metrics(results, index))
        write_frame(out, translation.stream.frame(index), report, translation, key)
        return False, FinishedFrame(report=report.without_arrays, key=key, pose=_pose_of(report))
    except Exception as error:  # noqa: BLE001 - a border: whatever one frame does, the others are translated
        foreseen = isinstance(error, TouchError)
        problem = str(error) if foreseen else error_log.log_error(error)
    return False, FinishedFrame(
        report=FrameReport(index=index, results={}, metrics={}, problem=problem, is_user_error=foreseen), key=""
    )


def _pose_of(report: FrameReport) -> ObjectPose | None:
    """The pose of a frame, None where it has none: across a gap nothing is followed."""
    result = report.results.get("pose")
    output = None if result is None else result.output
    return output if isinstance(output, ObjectPose) and output.sensor_from_object is not None else None


def _chosen(translation: Translation, graph: Graph, params: Mapping[str, object], frame: int | None) -> int:
    """The frame asked for, or the first one with a contact."""
    if frame is not None:
        return translation.check_index(frame)
    first = translation.stages[0]
    for index in range(translation.n_frames):
        result = graph.evaluate([first], translation.read_inputs(index), params)[first]
        contact = getattr(result.output, "contact", None)
        if contact.any() if contact is not None else result.state != "skipped":
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
