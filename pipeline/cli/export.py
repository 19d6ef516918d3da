"""`tactoscope export`, `bundle` and `replay`."""

import os
import shlex
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from pipeline.cli.terminal import open_progress_bar, print_error, print_line, print_table
from pipeline.cli.translation_options import (
    DEFAULT_OPTIONS,
    RecordingPath,
    StageSettings,
    TargetName,
    TranslationOptions,
)
from pipeline.lab.tasks.rerun import is_rollout_bundle, replay_rollout
from pipeline.translation.reports.export import export_file
from pipeline.translation.reports.export_request import SHEET, ExportRequest, PaneContent
from pipeline.translation.reports.repro_bundle import (
    REPLAY_TOLERANCE,
    StageAgreement,
    replay_bundle,
    write_bundle,
)

_DISPLAY_HELP = "`stage.parameter=value`, or `display.parameter=value` for the display; repeatable."
_DisplaySettings = Annotated[
    tuple[str, ...], Parameter(name="--set", negative="", help=_DISPLAY_HELP)
]


def export(
    recording: RecordingPath,
    *,
    target: TargetName,
    out: Annotated[Path, Parameter(name=("--out", "--to"))],
    options: TranslationOptions = DEFAULT_OPTIONS,
    pane: str = SHEET,
    content: PaneContent = "computed",
    frame: int = 0,
    frames: str = "",
    section: tuple[float, float, float, float] | None = None,
    size: tuple[int, int] | None = None,
    settings: _DisplaySettings = (),
) -> int:
    """Write one file of a translation.

    Returns 2 if frames that could not be read are left out, else 0.

    Args:
        out: File to write: .png or .pdf of a pane or the sheet, .ply of a pane's points in mm, .npz
            of its arrays, .csv of force and metrics of all frames, up to the pane, .mp4, .avi,
            .webm or animated .webp of a pane through the frames.
        pane: A stage, `source`, `sheet` for all of them side by side, `scene` for both sensors and
            the object in 3D, or `presentation` for source, scene, generated and recorded touch. The
            film of the scene is the press in motion, of --frame or of each of --frames.
        content: Computed value, ground truth, or their difference; the last two need ground truth.
        frame: Frame of an image, of points or of arrays.
        frames: Frames of a table or a video, such as `0,3-7`; default: all.
        section: x, y of the start and of the end of a line in mm from the source camera's axis, on
            the gel: the .csv then holds the height of each pane along it on one frame; --pane takes
            several, comma-separated.
        size: Width and height of a scene or presentation, pixels.
    """
    request = ExportRequest(
        request=options.build_request(recording, target),
        settings=settings,
        pane=pane,
        content=content,
        frame=frame,
        frames=frames,
        section=section or (),
        size_px=size,
        path=out,
    )
    with open_progress_bar() as progress:
        outcome = export_file(request, progress)
    for problem in outcome.problems:
        print_error(problem)
    for fallback in outcome.fallbacks:
        print_line(f"fallback used: {fallback}")
    print_line(f"{pane} written to {os.fspath(out)}")
    return 2 if outcome.problems else 0


def bundle(
    recording: RecordingPath,
    *,
    target: TargetName,
    out: Path,
    options: TranslationOptions = DEFAULT_OPTIONS,
    frame: int = 0,
    note: str = "",
    settings: StageSettings = (),
) -> int:
    """Write the repro bundle of one frame.

    Args:
        out: New folder to write.
        frame: Frame to bundle.
        note: Description of the problem.
    """
    with open_progress_bar() as progress:
        write_bundle(
            options.build_request(recording, target),
            settings,
            frame,
            out,
            note=note,
            progress=progress,
        )
    command = f"tactoscope replay {shlex.quote(os.fspath(out))}"
    print_line(f"repro bundle of frame {frame} written; replay it with: {command}")
    return 0


def replay(folder: Path) -> int:
    """Replay a repro bundle and print the agreement of each stage.

    Returns 0 if all agree, otherwise 1.

    Args:
        folder: Folder written by `tactoscope bundle`, `tactoscope rollout bundle` or the window.
    """
    if is_rollout_bundle(folder):
        return _replay_rollout(folder)
    with open_progress_bar() as progress:
        result = replay_bundle(folder, progress)
    if result.note:
        print_line(result.note)
    print_table(
        ("stage", "arrays", "agreement", "largest difference in"),
        (
            (
                stage.stage,
                str(stage.n_arrays),
                _format_agreement(stage),
                stage.worst_array if stage.largest_difference > 0 else "",
            )
            for stage in result.agreements
        ),
        most_letters=80,
    )
    for name, value in result.metrics.items():
        print_line(
            f"{name} {value:.4g}, recorded {result.expected_metrics.get(name, float('nan')):.4g}"
        )
    print_line("same result as recorded" if result.is_same else "NOT the recorded result")
    return 0 if result.is_same else 1


def _replay_rollout(folder: Path) -> int:
    with open_progress_bar() as progress:
        result = replay_rollout(folder, progress)
    if result.note:
        print_line(result.note)
    print_line(result.cause)
    agreement = result.agreement
    print_line(
        f"object within {agreement.pose_mm:.2g} mm, contact force within {agreement.force_n:.2g} "
        "N at every tick"
    )
    print_line("same result as recorded" if agreement.is_same else "NOT the recorded result")
    return 0 if agreement.is_same else 1


def _format_agreement(stage: StageAgreement) -> str:
    if stage.largest_difference == 0:
        return "same bytes"
    if stage.largest_difference == float("inf"):
        return "other shape, or other gaps"
    verdict = "same but for rounding" if stage.largest_difference <= REPLAY_TOLERANCE else "NO"
    return f"{verdict}: {stage.largest_difference:.2g} of its range"
