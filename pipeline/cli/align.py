"""`tactoscope align score` and `align refine`: how two sensors stand to each other, judged and mended."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from pipeline.alignment.refine import AlignmentFit, Refinement, refine_alignment
from pipeline.alignment.score import AlignmentScore, median_score, score_touches
from pipeline.alignment.sensitivity import UNIT_STEP, ScoreChange, Sensitivity, compute_sensitivities
from pipeline.alignment.target_observation import observe_target
from pipeline.alignment.touches import AlignmentTouch, load_paired_touches
from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.base.files import prepare_folder_for
from pipeline.base.frame_lists import parse_frames
from pipeline.cli.terminal import ProgressBar, create_progress_bar, print_line
from pipeline.sensors.alignment import AlignmentPart
from pipeline.sensors.alignment_files import ALIGNMENT_SUFFIX, AlignmentFile, save_alignment
from pipeline.translation.translate import Request, Translation, open_translation

_OPEN_DEG = 0.75  # spread of a turn: two touches of a sample leave 0.8 and lie 1.1 off, three leave 0.7 and lie 0.2 off


def show_scores(request: Request, frames: str, exact: bool) -> int:
    """Print how well every frame agrees under the alignment, and which axis matters; returns 0."""
    with closing(open_translation(request)) as translation, create_progress_bar() as bar:
        touches = _touches(translation, frames, exact, ProgressBar(bar))
        sides = [observe_target(t.target, translation.target) for t in touches]
        found = score_touches(touches, sides, translation.alignment, progress=ProgressBar(bar))
        most = int(np.argmax([s.overlap_px for s in found]))
        axes = compute_sensitivities(touches[most], translation.alignment, sides[most], progress=ProgressBar(bar))
    _print_scores(touches, found)
    _print_axes(axes, touches[most].index)
    return 0


def run_refinement(
    request: Request, out: Path, frames: str, *, hold_out: float, into: AlignmentPart, tolerance: float, exact: bool
) -> int:
    """Refine over all touches but those held out, print before and after, and write `out`; returns 0.

    Raises FileProblem when `out` exists, SettingProblem for a share to hold out that leaves nothing.
    """
    if out.suffix != ALIGNMENT_SUFFIX:
        raise FileProblem("an alignment is written as TOML; give --out a name that ends in .toml", out)
    if out.exists():
        raise FileProblem("this alignment exists already and is kept; choose another --out", out)
    if not 0.0 <= hold_out < 1.0:
        raise SettingProblem(f"--hold-out is a share of the frames, at least 0 and below 1, got {hold_out:g}")
    if not tolerance > 0:
        raise SettingProblem(f"--tolerance must be above 0, got {tolerance:g}")
    prepare_folder_for(out)
    with closing(open_translation(request)) as translation, create_progress_bar() as bar:
        touches = _touches(translation, frames, exact, ProgressBar(bar))
        used, held = split_held_out(touches, hold_out)
        answer = refine_alignment(
            used, translation.alignment, held_out=held, into=into, tolerance=tolerance, progress=ProgressBar(bar)
        )
    print_refinement(answer)
    kept = AlignmentFile(
        alignment=answer.alignment,
        source=translation.source.name,
        target=translation.target.name,
        origin=f"refined on {len(used)} touches of {request.recording.name}, change stored in {into}",
    )
    save_alignment(out, kept)
    print_line(f"alignment written to {os.fspath(out)}")
    return 0


def split_held_out(
    touches: Sequence[AlignmentTouch], hold_out: float
) -> tuple[list[AlignmentTouch], list[AlignmentTouch]]:
    """The touches to use and those held out, evenly spread; at least one is used."""
    n = min(round(hold_out * len(touches)), len(touches) - 1)
    out = {int((k + 0.5) * len(touches) / n) for k in range(n)} if n > 0 else set[int]()
    return [t for k, t in enumerate(touches) if k not in out], [t for k, t in enumerate(touches) if k in out]


def _touches(translation: Translation, frames: str, exact: bool, progress: ProgressBar) -> tuple[AlignmentTouch, ...]:
    chosen = parse_frames(frames, translation.n_frames)
    touches = load_paired_touches(translation, chosen, exact=exact, progress=progress)
    if not touches:
        pair = f"{translation.source.name} and {translation.target.name}"
        raise SettingProblem(
            f"none of the {len(chosen)} frames is felt by both {pair}; choose frames with contact on either side"
        )
    return touches


def _print_scores(touches: Sequence[AlignmentTouch], found: Sequence[AlignmentScore]) -> None:
    table = Table("frame", "mask IoU", "edge px", "depth mm", "depth rms mm", "too far by mm")
    rows = [(str(t.index), s) for t, s in zip(touches, found, strict=True)]
    middle = median_score(found)
    if middle is not None and len(found) > 1:
        rows.append(("median", middle))
    for name, s in rows:
        table.add_row(
            name,
            f"{s.iou:.3f}",
            _told(s.edge_px, 2),
            _told(s.depth_mm, 3),
            _told(s.depth_rms_mm, 3),
            _told(s.bias_mm, 3),
        )
    Console().print(table)


def _print_axes(axes: Sequence[Sensitivity], frame: int) -> None:
    table = Table(
        "axis", "mask IoU", "edge px", "depth rms mm", title=f"change per {UNIT_STEP:g} mm or deg, frame {frame}"
    )
    for one in axes:
        cells = (_change(one.iou, 4), _change(one.edge_px, 3), _change(one.depth_mm, 4))
        table.add_row(f"{one.axis} ({one.unit})", *cells)
    Console().print(table)
    print_line("size of the change to either side, and in brackets the slope along the axis")


def print_refinement(answer: Refinement) -> None:
    """Print how touches agree before and after, what moved, and what they do not tell."""
    table = Table("touches", "n", "surface mm", "outline mm", "compared")
    parts: list[tuple[str, tuple[AlignmentFit, AlignmentFit] | None]] = [
        ("used", answer.used_fit),
        ("held out", answer.held_out_fit),
    ]
    for name, pair in parts:
        for when, f in zip(("before", "after"), pair or (), strict=False):
            table.add_row(
                f"{name}, {when}",
                str(f.n_touches),
                f"{f.surface_mm:.3f}",
                f"{f.outline_mm:.3f}",
                f"{f.share_compared:.0%}",
            )
    Console().print(table)
    turn, shift = answer.std[:3], answer.std[3:]
    moved = answer.motion[:3, :3] @ answer.pivot_mm + answer.motion[:3, 3] - answer.pivot_mm
    print_line(f"moved the contact by {_triple(moved)} mm; predicted spread {_triple(shift)} mm, {_triple(turn)} deg")
    if float(np.max(turn)) > _OPEN_DEG:
        print_line(f"doubtful: a turn is known to {np.max(turn):.1f} deg only; more touches, in other places, tell it")
    for words in answer.weak_directions:
        print_line(f"not observable: {words}; left as it was")
    if answer.weak_directions:
        print_line("a larger --tolerance lets less certain directions move too")
    for note in answer.notes:
        print_line(f"note: {note}")


def _told(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _change(change: ScoreChange, digits: int) -> str:
    return f"{_told(change.magnitude, digits)} ({_told(change.slope, digits)})"


def _triple(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{v:.3f}" for v in values) + ")"
