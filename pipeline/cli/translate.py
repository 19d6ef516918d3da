"""`tactoscope translate`: frame by frame, each complete on disk before the next begins."""

import math
import os
import re
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console
from rich.text import Text

from pipeline.calibration.force_scale import UNKNOWN_SCALE
from pipeline.cli.terminal import open_progress_bar, print_error, print_line, print_table
from pipeline.cli.translation_options import (
    DEFAULT_OPTIONS,
    Flag,
    RecordingPath,
    StageSettings,
    TargetName,
    TranslationOptions,
)
from pipeline.core import compiling, user_folders
from pipeline.core.errors import NotConverged, SettingProblem, TouchError, escape_text
from pipeline.core.files import check_folder
from pipeline.core.frozen import frozen
from pipeline.core.params import check_range
from pipeline.core.processes import WorkerPool
from pipeline.core.progress import SILENT, Progress, SubProgress
from pipeline.core.values.frames import TactileFrame
from pipeline.translation.following import FROM_REST, Start, get_start, is_close
from pipeline.translation.force import list_force_metrics, measure_force
from pipeline.translation.frame_workers import (
    CACHE_BYTES,
    Opening,
    describe_opening,
    open_once,
)
from pipeline.translation.object_identification import take_likeliest_mesh
from pipeline.translation.reports.report import (
    FinishedFrame,
    compute_frame_key,
    load_finished_frame,
    write_frame,
    write_report,
)
from pipeline.translation.translate import Translation, open_translation
from pipeline.translation.translated_frame import FrameReport
from pipeline.translation.truth_view import add_truth_warnings

_FORCE_SKIPPED = (
    "force: skipped; give --force, or a --calibration that 'tactoscope calibrate force' wrote"
)
# processes, as requested and unasked
_MAX_JOBS = 64
_MAX_CORES = 8
_FRAMES_PER_WORKER = 24  # a process takes as long to start as some twenty frames with contact
# frames in a row that follow each other; the next run starts anew, so that results do not depend on
# the number of processes
_FOLLOWED_FRAMES = 24
_LISTED_FRAMES = 8  # frame numbers listed behind a warning


@frozen
class _Run:
    """Frames that one process translates in a row and writes into the common folder."""

    indices: tuple[int, ...]
    out: Path
    opening: Opening
    follow: bool | None  # whether each frame starts at the one before; None = if it is close
    force: bool
    sheets: bool


def translate(
    recording: RecordingPath,
    *,
    target: TargetName,
    out: Path,
    options: TranslationOptions = DEFAULT_OPTIONS,
    frame: int | None = None,
    all_frames: Annotated[bool, Parameter(name="--all", negative="")] = False,
    follow: bool | None = None,
    force: Flag = False,
    sheets: bool = True,
    settings: StageSettings = (),
    jobs: int = 0,
    meshes: Path | None = None,
) -> int:
    """Translate and write the frames that no earlier run has finished with the same request,
    settings and versions.

    Returns 0, 2 if some frame could not be translated (the report says why), 1 if one failed
    unexpectedly.

    Args:
        out: Folder for `frame_NNNN/stages.npz`, `frame_NNNN/sheet.png` and `report.json`.
        frame: The only frame to translate; default without --all: the first one with contact.
        all_frames: Translate every frame.
        follow: With --all, start pose and membrane at those of the previous frame, as exact and
            several times as fast; the notes say where. By default where frames are at most half a
            second apart, and anew every 24 frames; --no-follow: each frame alone.
        force: Compute the normal force of frames as well; done anyway with the scale of `tactoscope
            calibrate force`.
        sheets: Draw `sheet.png`, which takes as long as all stages of a frame and more.
        jobs: With --all, processes that translate frames at once, each with some 400 MB; 0 = one a
            core where there are frames enough to be worth their start.
        meshes: Folder of meshes; the likeliest one by the first translated frame is the object,
            with its margin noted.
    """
    _check_options(options, meshes, frame, jobs, all_frames=all_frames, follow=follow)
    request = options.build_request(recording, target)
    console = Console(stderr=True)
    translation = open_translation(request, settings=settings, cache_bytes=CACHE_BYTES)
    translation.check_index(0)
    force = force or translation.force_scale is not None
    check_folder(out)
    with (
        console.status("looking for a contact") as status,
        compiling.report_compiling(status.update),
    ):
        indices = range(translation.n_frames) if all_frames else [_select_frame(translation, frame)]
    if meshes is not None:
        with open_progress_bar(1, console) as bar:
            translation = take_likeliest_mesh(translation, meshes, indices[0], bar)
    length = 1 if follow is False else _choose_length(len(indices))
    whole = _Run(
        indices=tuple(indices),
        out=out.resolve(),
        opening=describe_opening(translation),
        follow=follow,
        force=force,
        sheets=sheets,
    )
    runs = [
        replace(whole, indices=whole.indices[k : k + length])
        for k in range(0, len(indices), length)
    ]
    n_workers = 0 if meshes else min(_choose_workers(jobs, len(indices)), len(runs))
    reports: list[FrameReport] = []
    n_resumed = 0
    try:
        with (
            open_progress_bar(len(indices), console) as bar,
            compiling.report_compiling(bar.show),
            closing(_translate_runs(runs, translation, n_workers, bar)) as finished,
        ):
            for is_resumed, one in finished:
                reports.append(one.report)
                n_resumed += is_resumed
    finally:  # also on Ctrl-C: finished frames are complete and listed
        translation.close()
        if reports:
            write_report(out, translation, reports)
    failed = [report for report in reports if report.problem]
    for report in failed:
        print_error(f"frame {report.index}: {report.problem}" if all_frames else report.problem)
    if len(failed) == len(reports) == 1:
        return _exit_code(failed)  # the tables below would be empty
    for note in translation.notes:
        line = Text(escape_text(f"note: {note}"), style="dim")
        console.print(line, highlight=False, soft_wrap=True)
    print_stage_table(reports)
    for line in (
        *list_fallbacks(reports),
        *list_warnings(reports),
        *_describe_force(reports, translation, force=force),
    ):
        print_line(line)
    if n_resumed:
        print_line(f"{n_resumed} of them were finished by an earlier run and are kept")
    print_line(f"{len(reports) - len(failed)} of {len(reports)} frames written to {os.fspath(out)}")
    return _exit_code(failed)


def _check_options(
    options: TranslationOptions,
    meshes: Path | None,
    frame: int | None,
    jobs: int,
    *,
    all_frames: bool,
    follow: bool | None,
) -> None:
    """Raise SettingProblem for options that exclude each other."""
    if meshes is not None and (options.mesh is not None or jobs):
        raise SettingProblem("--meshes chooses the mesh; give it without --mesh and --jobs")
    if frame is not None and all_frames:
        raise SettingProblem("give either --frame or --all, not both")
    if follow and not all_frames:
        raise SettingProblem("--follow starts at the previous frame; give it with --all")
    if jobs and not all_frames:
        raise SettingProblem("--jobs share frames; give it with --all")
    check_range("--jobs", jobs, 0, _MAX_JOBS)


def print_stage_table(reports: Sequence[FrameReport]) -> None:
    """Print per stage the median and largest time in ms, how often it was skipped, and its
    errors.
    """
    done = [report for report in reports if report.results]
    rows: list[tuple[str, ...]] = []
    for name in done[0].results if done else ():
        ms = sorted(report.results[name].ms for report in done)
        skipped = sum(report.results[name].state == "skipped" for report in done)
        times = (f"{ms[len(ms) // 2]:.2f}", f"{ms[-1]:.2f}")
        rows.append((name, *times, f"{skipped} of {len(done)}", _format_metrics(name, done)))
    print_table(("stage", "median ms", "largest ms", "skipped", "error against ground truth"), rows)


def list_fallbacks(reports: Sequence[FrameReport]) -> list[str]:
    """One sentence for each stage that another method than the requested one computed, with the
    reason.
    """
    reasons: dict[tuple[str, str], list[str]] = {}
    for report in reports:
        for name, result in report.results.items():
            if result.fallback:
                reasons.setdefault((name, result.badge), []).append(result.fallback)
    return [
        f"fallback used in {len(found)} of {len(reports)} frames: {name}: {found[0]}"
        for (name, _), found in sorted(reasons.items())
    ]


def list_warnings(reports: Sequence[FrameReport]) -> list[str]:
    """Every warning once with its frames, at its first stage.

    Warnings that differ in numbers only are merged.
    """
    stages: dict[str, str] = {}
    frames: dict[str, dict[int, str]] = {}
    for report in reports:
        for name, result in report.results.items():
            for warning in result.warnings:
                kind = re.sub(r"[\d.,]*\d", "", warning)
                stages.setdefault(kind, name)
                frames.setdefault(kind, {}).setdefault(report.index, warning)
    return [
        f"warning: {stages[kind]}: {next(iter(texts.values()))}"
        + (f" ({_format_frames(texts)})" if len(reports) > 1 else "")
        for kind, texts in frames.items()
    ]


def _format_frames(warnings_by_frame: Mapping[int, str]) -> str:
    """The first frame numbers, and which frame the numbers in the warning are of where they
    differ.
    """
    few = ", ".join(str(n) for n in list(warnings_by_frame)[:_LISTED_FRAMES])
    if len(warnings_by_frame) == 1:
        return f"frame {few}"
    first = next(iter(warnings_by_frame))
    numbers_of = f"; numbers of frame {first}" if len(set(warnings_by_frame.values())) > 1 else ""
    more = ", …" if len(warnings_by_frame) > _LISTED_FRAMES else ""
    return f"{len(warnings_by_frame)} frames: {few}{more}{numbers_of}"


def _describe_force(
    reports: Sequence[FrameReport], translation: Translation, *, force: bool
) -> list[str]:
    """The range of the forces, and whether its scale is known or it was skipped.

    Empty without a contact model.
    """
    if not force:
        return [_FORCE_SKIPPED] if list_force_metrics(translation) else []
    out: list[str] = []
    remark = f"; {UNKNOWN_SCALE}" if translation.force_scale is None else ""
    titles = ("normal force", "shear force")
    for name, title in zip(list_force_metrics(translation), titles, strict=False):
        forces = [report.metrics[name] for report in reports if name in report.metrics]
        if any(forces):
            ends = dict.fromkeys(f"{end:.2f}" for end in (min(forces), max(forces)))
            out.append(f"{title} {' to '.join(ends)} N{remark}")
    return out


def _choose_workers(jobs: int, n_frames: int) -> int:
    """How many processes translate `n_frames`: as requested, else one a core, each with some
    frames to do.
    """
    return min(
        n_frames, jobs or min(os.cpu_count() or 1, _MAX_CORES, n_frames // _FRAMES_PER_WORKER)
    )


def _choose_length(n_frames: int) -> int:
    """How many frames in a row follow each other: all, or such that an even number of runs, for two
    processes, are equally long.
    """
    if n_frames <= _FOLLOWED_FRAMES:
        return n_frames
    n_runs = 2 * math.ceil(n_frames / (2 * _FOLLOWED_FRAMES))
    return math.ceil(n_frames / n_runs)


def _translate_runs(
    runs: Sequence[_Run],
    translation: Translation,
    n_workers: int,
    progress: Progress,
) -> Generator[tuple[bool, FinishedFrame]]:
    """Yield (whether an earlier run had finished it, the frame) of all frames in order, translated
    by processes of this machine, or here.
    """
    if n_workers > 1:
        n_frames = sum(len(run.indices) for run in runs)
        n_done = 0
        with WorkerPool(n_workers) as pool:
            for future in [pool.submit(_run_elsewhere, run) for run in runs]:
                try:
                    frames = future.result()
                except BrokenExecutor as error:
                    raise NotConverged(
                        "a process died, perhaps out of memory; run again with --jobs 1, which "
                        "keeps the finished frames"
                    ) from error
                n_done += len(frames)
                progress.step(
                    n_done / n_frames, f"{n_done} of {n_frames} frames by {n_workers} processes"
                )
                yield from frames
    else:
        for k, run in enumerate(runs):
            yield from _translate_run(
                run, translation, SubProgress(progress, k / len(runs), 1.0 / len(runs))
            )


def _run_elsewhere(run: _Run) -> list[tuple[bool, FinishedFrame]]:
    """Translate frames in a worker, which keeps the recording and the weights open."""
    return list(_translate_run(run, open_once(run.opening), SILENT))


@frozen
class _Last:
    """The last frame of a run, which the next one may follow."""

    time_s: float = math.nan
    key: str = ""
    start: Start = FROM_REST  # after it, but for the frames that an earlier run had finished
    finished: tuple[TactileFrame, ...] = ()


def _translate_run(
    run: _Run, translation: Translation, progress: Progress
) -> Iterator[tuple[bool, FinishedFrame]]:
    last = _Last()
    n_frames = len(run.indices)
    for done, index in enumerate(run.indices):
        part = SubProgress(progress, done / n_frames, 1.0 / n_frames, f"frame {index}")
        part.step(0.0, "")
        is_resumed, one, last = _translate_frame(translation, index, run, last, part)
        yield is_resumed, one


def _exit_code(failed: Sequence[FrameReport]) -> int:
    return 0 if not failed else 2 if all(report.is_user_error for report in failed) else 1


def _translate_frame(
    translation: Translation, index: int, run: _Run, last: _Last, progress: Progress
) -> tuple[bool, FinishedFrame, _Last]:
    """(whether an earlier run had finished it, the frame, it for the next one).

    A frame that fails has its problem in the report.
    """
    try:
        # read once: a frame and its truth are a tenth of the time of all stages
        frame = translation.stream.frame(index)
        truth = translation.read_ground_truth(index)
        follows = is_close(last.time_s, frame.time_s) if run.follow is None else run.follow
        last = last if follows else _Last()
        key = compute_frame_key(translation, frame, truth, last.key, with_force=run.force)
        finished = load_finished_frame(run.out, index, key, sheet=run.sheets)
        if finished is not None:
            kept = (*last.finished, frame)
            return True, finished, replace(last, time_s=frame.time_s, key=key, finished=kept)
        start = last.start
        for before in last.finished:  # again, as the frame follows them
            start = get_start(translation.evaluate(before, progress=progress, start=start))
        results = translation.evaluate(frame, progress=progress, start=start)
        start = get_start(results)
        results = {name: add_truth_warnings(result, truth) for name, result in results.items()}
        metrics = translation.compute_metrics_against(results, truth)
        if run.force:
            metrics |= measure_force(results, index, translation)
        report = FrameReport(index=index, results=results, metrics=metrics)
        write_frame(run.out, frame, report, translation, key, sheet=run.sheets)
        done = FinishedFrame(report=report.without_arrays, key=key)
        return False, done, _Last(time_s=frame.time_s, key=key, start=start)
    except Exception as error:  # noqa: BLE001 - whatever one frame does, the others are translated
        is_user_error = isinstance(error, TouchError)
        problem = str(error) if is_user_error else user_folders.log_error(error)
    report = FrameReport(
        index=index, results={}, metrics={}, problem=problem, is_user_error=is_user_error
    )
    return False, FinishedFrame(report=report, key=""), _Last()


def _select_frame(translation: Translation, frame: int | None) -> int:
    """The requested frame, or the first one with contact."""
    if frame is not None:
        return translation.check_index(frame)
    first = translation.stages[0]
    for index in range(translation.n_frames):
        result = translation.evaluate(index, [first])[first]
        contact = getattr(result.output, "contact", None)
        if contact.any() if contact is not None else result.state != "skipped":
            return index
    return 0


def _format_metrics(name: str, reports: Sequence[FrameReport]) -> str:
    """Median of every metric of a stage."""
    found: dict[str, list[float]] = {}
    for report in reports:
        for key, value in report.metrics.items():
            stage, _, metric = key.partition(".")
            if stage == name and not math.isnan(value):
                found.setdefault(metric, []).append(value)
    medians = (
        f"{metric} {sorted(values)[len(values) // 2]:.3g}"
        for metric, values in sorted(found.items())
    )
    return ", ".join(medians) or "no ground truth"
