"""`tactoscope align score` and `align refine`: score and refine the alignment of two sensors."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from cyclopts import Parameter

from pipeline.cli.terminal import format_number, open_progress_bar, print_line, print_table
from pipeline.cli.translation_options import Flag
from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.files import check_folder_for
from pipeline.core.frame_lists import parse_frames
from pipeline.core.frozen import frozen
from pipeline.sensors.alignment import ALIGNMENT_SUFFIX, AlignmentFile, save_alignment
from pipeline.translation.alignment import refine as refinement
from pipeline.translation.alignment.refine import (
    Refinement,
    estimate_alignment,
    hold_out_touches,
    refine_on_recording,
)
from pipeline.translation.alignment.score import (
    UNIT_STEP,
    AlignmentScore,
    ScoreChange,
    Sensitivity,
    compute_sensitivities,
    median_score,
    observe_target,
    score_touches,
)
from pipeline.translation.alignment.touches import AlignmentTouch, load_paired_touches
from pipeline.translation.translate import Request, Translation, open_translation

# Predicted standard deviation of a rotation from which a warning is printed. Two touches of a
# sample leave 0.8 deg and are 1.1 deg off, three leave 0.7 deg and are 0.2 deg off.
_WARN_ROTATION_STD_DEG = 0.75


@Parameter(name="*")
@frozen
class PairedTouchOptions:
    """Touches that both sensors recorded.

    Args:
        target: Target sensor.
        sensor: Source sensor; default: the recording's first.
        stream: Name of the source's stream, if one sensor has several.
        frames: Frames of a recording, such as `0,3-7`; default: all.
        truth: Use the recording's ground-truth depth and contact, not the depth stage's.
    """

    target: str
    sensor: str = ""
    stream: str = ""
    frames: str = ""
    truth: Flag = False

    def build_request(self, recording: Path, alignment: Path | None = None) -> Request:
        """Request from source to target sensor."""
        return Request(
            recording=recording,
            target=self.target,
            source=self.sensor,
            stream=self.stream,
            alignment=alignment,
        )


def score(recording: Path, *, touches: PairedTouchOptions, alignment: Path | None = None) -> int:
    """Print the agreement of every frame under the alignment, and the sensitivity to each axis.

    Returns 0.

    Args:
        recording: Recording of both sensors.
        alignment: The .toml to score; default: the recording's alignment, or that of the sensor
            descriptions.
    """
    with (
        open_translation(touches.build_request(recording, alignment)) as translation,
        open_progress_bar() as progress,
    ):
        frames = parse_frames(touches.frames, translation.n_frames)
        pairs = load_paired_touches(translation, frames, exact=touches.truth, progress=progress)
        observed = [observe_target(pair.target, translation.target) for pair in pairs]
        scores = score_touches(pairs, observed, translation.alignment, progress=progress)
        best = int(np.argmax([score.overlap_px for score in scores]))
        sensitivities = compute_sensitivities(
            pairs[best], translation.alignment, observed[best], progress=progress
        )
    _print_scores(pairs, scores)
    _print_sensitivities(sensitivities, pairs[best].index)
    return 0


def refine_alignment(
    recording: Path,
    *,
    touches: PairedTouchOptions,
    out: Path,
    alignment: Path | None = None,
    hold_out: float = 0.2,
    tolerance: float = 1.0,
) -> int:
    """Refine over all touches but those held out, print the fit before and after, and write it.

    Raises FileProblem if `out` exists, SettingProblem if no touch is left to fit to.

    Args:
        recording: Recording of both sensors.
        out: The .toml to write.
        alignment: Initial alignment, a .toml; default: the recording's, or that of the sensor
            descriptions.
        hold_out: Share of the touches that are not fitted to, only scored before and after.
        tolerance: Directions with a predicted standard deviation above this times 0.2 mm or 1
            degree stay unchanged.
    """
    if not tolerance > 0:
        raise SettingProblem(f"--tolerance must be above 0, got {tolerance:g}")
    with (
        _open_pairs(recording, touches, out, hold_out, alignment) as translation,
        open_progress_bar() as progress,
    ):
        fit = refine_on_recording(
            translation,
            parse_frames(touches.frames, translation.n_frames),
            exact=touches.truth,
            hold_out=hold_out,
            tolerance=tolerance,
            progress=progress,
        )
    origin = f"refined on {fit.used_fit[0].n_touches} touches of {recording.name}"
    _write_refinement(out, translation, fit, origin)
    return 0


def fit_alignment(
    recording: Path, *, touches: PairedTouchOptions, out: Path, hold_out: float = 0.2
) -> int:
    """Search all orientations in the plane, refine the best one, print the fit and write the
    alignment; returns 0.

    Args:
        recording: Recording of both sensors; optical axes are within about 20 degrees of parallel.
        out: The .toml to write.
        hold_out: Share of the touches that are not fitted to, only scored before and after.
    """
    with (
        _open_pairs(recording, touches, out, hold_out) as translation,
        open_progress_bar() as progress,
    ):
        frames = parse_frames(touches.frames, translation.n_frames)
        found = load_paired_touches(translation, frames, exact=touches.truth, progress=progress)
        used, held_out = hold_out_touches(found, hold_out)
        start = estimate_alignment(used, translation.alignment, progress)
        fit = refinement.refine_alignment(used, start, held_out=held_out, progress=progress)
    origin = f"fitted to {len(used)} touches of {recording.name}, without an initial alignment"
    _write_refinement(out, translation, fit, origin)
    return 0


def _open_pairs(
    recording: Path,
    touches: PairedTouchOptions,
    out: Path,
    hold_out: float,
    alignment: Path | None = None,
) -> Translation:
    """Check where to write and what to hold out before a recording is opened."""
    if not 0.0 <= hold_out < 1.0:
        raise SettingProblem(
            f"--hold-out is a share of the frames, at least 0 and below 1, got {hold_out:g}"
        )
    if out.suffix != ALIGNMENT_SUFFIX:
        raise FileProblem(
            "an alignment is written as TOML; give --out a name that ends in .toml", out
        )
    if out.exists():
        raise FileProblem("this alignment exists already and is kept; choose another --out", out)
    check_folder_for(out)
    return open_translation(touches.build_request(recording, alignment))


def _write_refinement(out: Path, translation: Translation, fit: Refinement, origin: str) -> None:
    print_refinement(fit)
    names = {"source": translation.source.name, "target": translation.target.name}
    save_alignment(out, AlignmentFile(alignment=fit.alignment, origin=origin, **names))
    print_line(f"alignment written to {os.fspath(out)}; use it with --alignment")


def _print_scores(touches: Sequence[AlignmentTouch], scores: Sequence[AlignmentScore]) -> None:
    rows = [(str(touch.index), score) for touch, score in zip(touches, scores, strict=True)]
    median = median_score(scores)
    if median is not None and len(scores) > 1:
        rows.append(("median", median))
    print_table(
        ("frame", "mask IoU", "edge px", "depth mm", "depth rms mm", "bias mm"),
        (
            (
                name,
                f"{score.iou:.3f}",
                format_number(score.edge_px, ".2f"),
                format_number(score.depth_mm, ".3f"),
                format_number(score.depth_rms_mm, ".3f"),
                format_number(score.bias_mm, ".3f"),
            )
            for name, score in rows
        ),
    )


def _print_sensitivities(sensitivities: Sequence[Sensitivity], frame: int) -> None:
    print_table(
        ("axis", "mask IoU", "edge px", "depth rms mm"),
        (
            (
                f"{axis.axis} ({axis.unit})",
                _format_change(axis.iou, ".4f"),
                _format_change(axis.edge_px, ".3f"),
                _format_change(axis.depth_mm, ".4f"),
            )
            for axis in sensitivities
        ),
        title=f"change per {UNIT_STEP:g} mm or deg, frame {frame}",
    )
    print_line("mean absolute change to either side, in brackets the slope along the axis")


def print_refinement(fit: Refinement) -> None:
    """Print the fit before and after, the motion, and the directions that the touches do not
    determine.
    """
    print_table(
        ("touches", "n", "surface mm", "outline mm", "compared"),
        (
            (
                f"{name}, {when}",
                str(one.n_touches),
                f"{one.surface_mm:.3f}",
                f"{one.outline_mm:.3f}",
                f"{one.share_compared:.0%}",
            )
            for name, pair in (("used", fit.used_fit), ("held out", fit.held_out_fit))
            for when, one in zip(("before", "after"), pair or (), strict=False)
        ),
    )
    rotation = fit.std[:3]
    translation = fit.std[3:]
    moved = fit.motion[:3, :3] @ fit.pivot_mm + fit.motion[:3, 3] - fit.pivot_mm
    std = f"{_format_vector(translation)} mm, {_format_vector(rotation)} deg"
    print_line(
        f"moved the contact by {_format_vector(moved)} mm; predicted standard deviation {std}"
    )
    if float(np.max(rotation)) > _WARN_ROTATION_STD_DEG:
        print_line(
            f"warning: a rotation has a standard deviation of {np.max(rotation):.1f} deg; "
            "add touches in other places to reduce it"
        )
    for direction in fit.weak_directions:
        print_line(f"not observable: {direction}; unchanged")
    if fit.weak_directions:
        print_line("a larger --tolerance also changes less certain directions")
    for note in fit.notes:
        print_line(f"note: {note}")


def _format_change(change: ScoreChange, form: str) -> str:
    return f"{format_number(change.magnitude, form)} ({format_number(change.slope, form)})"


def _format_vector(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{v:.3f}" for v in values) + ")"
