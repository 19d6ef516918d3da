"""`tactoscope align fit`: how two sensors stand to each other, from a few touches that both felt."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from pipeline.alignment.fit.fitting import PairsFit, fit_pairs, score_fit
from pipeline.alignment.fit.pairs import ImprintPairs, load_tile_pairs, make_touch_pairs
from pipeline.alignment.fit.rigid_start import align_rigidly
from pipeline.alignment.fit.transfer import FREE_PARAMETERS, ImprintPair
from pipeline.alignment.refine import refine_alignment
from pipeline.alignment.touches import load_paired_touches
from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.base.files import prepare_folder_for
from pipeline.base.frame_lists import parse_frames
from pipeline.base.stage_warnings import StageWarning
from pipeline.cli.align import print_refinement
from pipeline.cli.terminal import ProgressBar, create_progress_bar, print_line
from pipeline.sensors.alignment_files import ALIGNMENT_SUFFIX, AlignmentFile, save_alignment
from pipeline.sensors.spec import load_sensor
from pipeline.translation.translate import Request, open_translation

_LEAST_AGREEMENT = 0.2  # correlation: real pairs have 0.63, the same pairs shuffled -0.12 (touch2touch tiles)
_AS_GOOD = 0.5  # of the correlation of the pairs fitted to
_WORDS = {
    "rotation_rad": ("rotation", "deg"), "log_scale": ("scale", "share"), "right": ("shift right", ""), "down": ("shift down", ""),
    "tilt_right": ("tilt to the right", "of the press"), "tilt_down": ("tilt downward", "of the press"),
    "rest_curvature": ("rest curvature", "of the press"),
}  # fmt: skip


def has_tiles(path: Path, source_names: str) -> bool:
    """Whether a folder holds pictures of these names."""
    return path.is_dir() and next(path.glob(source_names), None) is not None


def fit_tiles(folder: Path, source: str, target: str, names: tuple[str, str], use: int, seed: int) -> int:
    """Fit to some tiles of a folder, score the others, and print the map; nothing metric can be written."""
    if use < 2:
        raise SettingProblem(f"--use must be at least 2 pairs, got {use}")
    load_sensor(target)  # an unknown one is refused before the work
    found = load_tile_pairs(folder, load_sensor(source), *names)
    used, others = _split(found.pairs, use, seed)
    with create_progress_bar() as bar:
        answer = fit_pairs(used, ProgressBar(bar))
    _print_notes(found, len(used), len(others))
    _print_fit(answer, "tile widths")
    _print_scores(answer, others)
    print_line(
        "tiles are stretched and squeezed: millimetres, the depth of the press and the distance along the view are not "
        "determined, and no alignment file is written"
    )
    return 0


def fit_recording(request: Request, out: Path | None, frames: str, use: int, seed: int, *, exact: bool) -> int:
    """Fit to touches of a recording of both sensors, refine in all six directions, and write the alignment."""
    if use < 2:
        raise SettingProblem(f"--use must be at least 2 pairs, got {use}")
    if out is None:
        raise SettingProblem("a recording gives a metric alignment; name the .toml for it with --out")
    if out.suffix != ALIGNMENT_SUFFIX or out.exists():
        raise FileProblem("--out must be a new file whose name ends in .toml", out)
    prepare_folder_for(out)
    with closing(open_translation(request)) as translation, create_progress_bar() as bar:
        chosen = parse_frames(frames, translation.n_frames)
        touches = [
            t
            for t in load_paired_touches(translation, chosen, exact=exact, progress=ProgressBar(bar))
            if t.has_contact_on_both
        ]
        by_name = {str(t.index): t for t in touches}
        found = make_touch_pairs(touches)
        used, others = _split(found.pairs, use, seed)
        answer = fit_pairs(used, ProgressBar(bar))
        start = align_rigidly([by_name[p.name] for p in used], answer.transfer, translation.alignment)
        held = [by_name[p.name] for p in others]
        refined = refine_alignment([by_name[p.name] for p in used], start, held_out=held, progress=ProgressBar(bar))
    _print_notes(found, len(used), len(others))
    _print_fit(answer, "mm")
    _print_scores(answer, others)
    print_line(f"press of the touches used: {_press_mm(used)} mm (median of the deepest; lightest to deepest)")
    print_refinement(refined)
    origin = f"fitted to {len(used)} touches of {request.recording.name}, without an alignment to begin with"
    save_alignment(out, AlignmentFile(alignment=refined.alignment, source=translation.source.name,
                            target=translation.target.name, origin=origin))  # fmt: skip
    print_line(f"alignment written to {os.fspath(out)}; use it with --alignment")
    return 0


def _split(pairs: Sequence[ImprintPair], use: int, seed: int) -> tuple[list[ImprintPair], list[ImprintPair]]:
    """Some to fit and the others to judge by, drawn by `seed`; two are kept to judge by where there are enough."""
    n = min(use, max(2, len(pairs) - 2))
    taken = set(np.random.default_rng(seed).permutation(len(pairs))[:n].tolist())
    return [p for k, p in enumerate(pairs) if k in taken], [p for k, p in enumerate(pairs) if k not in taken]


def _press_mm(pairs: Sequence[ImprintPair]) -> str:
    deepest = sorted(float(p.imprint.max()) for p in pairs)
    return f"{np.median(deepest):.2f} ({deepest[0]:.2f} to {deepest[-1]:.2f})"


def _print_notes(found: ImprintPairs, n_used: int, n_others: int) -> None:
    for note in found.notes:
        print_line(f"{'doubtful' if isinstance(note, StageWarning) else 'note'}: {note}")
    print_line(f"{n_used} pairs are fitted to, {n_others} are held out")


def _print_fit(answer: PairsFit, unit: str) -> None:
    how = answer.transfer
    mirror = "mirrored left to right, then " if how.is_mirrored else ""
    best, second = answer.initial_guesses[0], answer.initial_guesses[1]
    print_line(
        f"orientation: {mirror}turned by {math.degrees(how.rotation_rad):.1f} deg; before fitting, {best[0]} agrees by "
        f"{best[1]:.2f}, the next best way to lay the source's picture, {second[0]}, by {second[1]:.2f}"
    )
    table = Table("number", "value", "spread", "unit")
    values = dict(zip(FREE_PARAMETERS, how.values(), strict=True))
    for name, (words, of) in _WORDS.items():
        value, spread = values[name], answer.std[name]
        if name == "rotation_rad":
            value, spread = math.degrees(value), math.degrees(spread)
        if name == "log_scale" and unit == "mm":
            continue  # it is 1
        if name == "log_scale":
            value, spread = how.scale, how.scale * spread
        table.add_row(words, f"{value:.3f}", f"{spread:.3f}", of or unit)
    Console().print(table)
    for name in answer.undetermined:
        print_line(f"not determined by these pairs: {_WORDS[name][0]}")


def _print_scores(answer: PairsFit, others: Sequence[ImprintPair]) -> None:
    less = ", the mean imprint of the pairs used taken away" if answer.mean_imprint is not None else ""
    print_line(f"correlation of expected and real imprints{less}: pairs used {_told(answer.correlations)}")
    held = [score_fit(p, answer.transfer, answer.mean_imprint) for p in others]
    if held:
        print_line(f"  held out: {_told(held)}")
    if not is_consistent(answer.correlations, held):
        print_line("doubtful: the map carries next to nothing over to touches that it was not fitted to: are the two "
                   "readings of each pair of one touch, and in the same order?")  # fmt: skip


def is_consistent(used: Sequence[float], held_out: Sequence[float]) -> bool:
    """Whether correlations of the pairs fitted to, and of those held out (there may be none), speak for one map."""
    judged = float(np.mean(held_out if len(held_out) else used))
    return judged > max(_LEAST_AGREEMENT, _AS_GOOD * float(np.mean(used)))


def _told(scores: Sequence[float]) -> str:
    low, high = np.percentile(scores, [10, 90])
    return f"mean {np.mean(scores):.3f} (10 to 90 %: {low:.2f} to {high:.2f})"
