"""`tactoscope align fit`: the alignment of two sensors from a few paired touches, without an initial one."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from pipeline.alignment.coarse_start import align_rigidly, align_tiles, compute_described_scale, make_touch_pairs
from pipeline.alignment.refine import refine_alignment
from pipeline.alignment.touches import load_paired_touches
from pipeline.base.errors import SettingProblem, StageWarning
from pipeline.base.frame_lists import parse_frames
from pipeline.cli.align import PairedTouchOptions, prepare_alignment_file, print_refinement, write_alignment
from pipeline.cli.terminal import open_progress_bar, print_line
from pipeline.imprints.fitting import PairsFit, fit_pairs, score_fit
from pipeline.imprints.tiles import SOURCE_TILES, TARGET_TILES, ImprintPairs, load_tile_pairs
from pipeline.imprints.transfer import FREE_PARAMETERS, ImprintPair
from pipeline.sensors.alignment import resolve_alignment
from pipeline.sensors.alignment_files import AlignmentFile
from pipeline.sensors.spec import load_sensor
from pipeline.translation.translate import open_translation

_MIN_CORRELATION = 0.2  # real pairs have 0.63, the same pairs shuffled -0.12 (touch2touch tiles)
_MIN_HELD_OUT_SHARE = 0.5  # correlation of the pairs held out as a share of that of the pairs fitted to
_PARAMETER_TITLES = {  # parameter of the map -> (title, unit; "" = that of the tiles or mm)
    "rotation_rad": ("rotation", "deg"),
    "log_scale": ("scale", "share"),
    "right": ("shift right", ""),
    "down": ("shift down", ""),
    "tilt_right": ("tilt to the right", "of the press"),
    "tilt_down": ("tilt downward", "of the press"),
    "rest_curvature": ("rest curvature", "of the press"),
}


def fit(
    pairs: Path,
    *,
    touches: PairedTouchOptions,
    out: Path | None = None,
    use: int = 10,
    seed: int = 0,
    source_tiles: str = SOURCE_TILES,
    target_tiles: str = TARGET_TILES,
) -> int:
    """Fit to some pairs, score the others, and write the alignment; returns 0.

    Args:
        pairs: Recording of both sensors, or a folder of tiles: difference images and imprints.
        out: The .toml to write; of tiles it holds the in-plane motion, with distance and tilt of the descriptions.
        use: Number of pairs to fit to; the others are scored.
        seed: Seed of the choice of pairs.
        source_tiles: File names of the source's tiles; `*` stands for the same text in both tiles of a pair.
        target_tiles: File names of the target's tiles.
    """
    if use < 2:
        raise SettingProblem(f"--use must be at least 2 pairs, got {use}")
    if pairs.is_dir() and next(pairs.glob(source_tiles), None) is not None:
        return _fit_tiles(pairs, touches, (source_tiles, target_tiles), out, use, seed)
    return _fit_recording(pairs, touches, out, use, seed)


def _fit_tiles(
    folder: Path, touches: PairedTouchOptions, names: tuple[str, str], out: Path | None, use: int, seed: int
) -> int:
    source, target = load_sensor(touches.sensor or "gelslim"), load_sensor(touches.target)
    if out is not None:
        prepare_alignment_file(out)
    loaded = load_tile_pairs(folder, source, *names)
    used, held_out = _split_pairs(loaded.pairs, use, seed)
    with open_progress_bar() as progress:
        answer = fit_pairs(used, progress)
    _print_notes(loaded, len(used), len(held_out))
    _print_fit(answer, "tile widths")
    _print_scores(answer, held_out)
    described = resolve_alignment(source, target)
    print_line(
        "tiles are not metric: the distance of the sensors and their tilt are those of the descriptions, by which "
        f"the scale would be {compute_described_scale(source, target, described):.3f}"
    )
    if out is not None:
        origin = f"in-plane motion fitted to {len(used)} pairs of tiles of {folder.name}"
        alignment = align_tiles(answer.transfer, source, target, described)
        write_alignment(out, AlignmentFile(alignment=alignment, source=source.name, target=target.name, origin=origin))
    return 0


def _fit_recording(recording: Path, options: PairedTouchOptions, out: Path | None, use: int, seed: int) -> int:
    """Fit to touches of both sensors, refine in all six directions, and write the alignment."""
    if out is None:
        raise SettingProblem("a recording gives a metric alignment; name the .toml for it with --out")
    prepare_alignment_file(out)
    with open_translation(options.build_request(recording)) as translation, open_progress_bar() as progress:
        frames = parse_frames(options.frames, translation.n_frames)
        loaded = load_paired_touches(translation, frames, exact=options.truth, progress=progress)
        touches = [touch for touch in loaded if touch.has_contact_on_both]
        by_name = {str(touch.index): touch for touch in touches}
        found = make_touch_pairs(touches)
        used, held_out = _split_pairs(found.pairs, use, seed)
        answer = fit_pairs(used, progress)
        start = align_rigidly([by_name[p.name] for p in used], answer.transfer, translation.alignment)
        held_out_touches = [by_name[p.name] for p in held_out]
        refined = refine_alignment([by_name[p.name] for p in used], start, held_out=held_out_touches, progress=progress)
    _print_notes(found, len(used), len(held_out))
    _print_fit(answer, "mm")
    _print_scores(answer, held_out)
    print_line(f"indentation of the touches used: {_format_depths(used)} mm (median of the deepest points; range)")
    print_refinement(refined)
    origin = f"fitted to {len(used)} touches of {recording.name}, without an initial alignment"
    write_alignment(out, AlignmentFile(alignment=refined.alignment, source=translation.source.name,
                             target=translation.target.name, origin=origin))  # fmt: skip
    return 0


def _split_pairs(pairs: Sequence[ImprintPair], use: int, seed: int) -> tuple[list[ImprintPair], list[ImprintPair]]:
    """(pairs to fit to, pairs held out), chosen by `seed`; two are held out if there are enough."""
    n = min(use, max(2, len(pairs) - 2))
    used = set(np.random.default_rng(seed).permutation(len(pairs))[:n].tolist())
    return [p for k, p in enumerate(pairs) if k in used], [p for k, p in enumerate(pairs) if k not in used]


def _format_depths(pairs: Sequence[ImprintPair]) -> str:
    deepest = sorted(float(p.imprint.max()) for p in pairs)
    return f"{np.median(deepest):.2f} ({deepest[0]:.2f} to {deepest[-1]:.2f})"


def _print_notes(pairs: ImprintPairs, n_used: int, n_held_out: int) -> None:
    for note in pairs.notes:
        print_line(f"{'warning' if isinstance(note, StageWarning) else 'note'}: {note}")
    print_line(f"{n_used} pairs are fitted to, {n_held_out} are held out")


def _print_fit(answer: PairsFit, unit: str) -> None:
    how = answer.transfer
    mirror = "mirrored left to right, then " if how.is_mirrored else ""
    best, second = answer.initial_guesses[0], answer.initial_guesses[1]
    print_line(
        f"orientation: {mirror}rotated by {math.degrees(how.rotation_rad):.1f} deg; "
        f"correlation before fitting: {best[0]} "
        f"{best[1]:.2f}, next best {second[0]} {second[1]:.2f}"
    )
    table = Table("parameter", "value", "standard deviation", "unit")
    values = dict(zip(FREE_PARAMETERS, how.values(), strict=True))
    for name, (title, own_unit) in _PARAMETER_TITLES.items():
        value, spread = values[name], answer.std[name]
        if name == "rotation_rad":
            value, spread = math.degrees(value), math.degrees(spread)
        if name == "log_scale" and unit == "mm":
            continue  # it is 1
        if name == "log_scale":
            value, spread = how.scale, how.scale * spread
        table.add_row(title, f"{value:.3f}", f"{spread:.3f}", own_unit or unit)
    Console().print(table)
    for name in answer.undetermined:
        print_line(f"not determined by these pairs: {_PARAMETER_TITLES[name][0]}")


def _print_scores(answer: PairsFit, held_out: Sequence[ImprintPair]) -> None:
    less = ", less the mean imprint of the pairs used" if answer.mean_imprint is not None else ""
    print_line(
        f"correlation of expected and real imprints{less}: pairs used {_format_correlations(answer.correlations)}"
    )
    scores = [score_fit(p, answer.transfer, answer.mean_imprint) for p in held_out]
    if scores:
        print_line(f"  held out: {_format_correlations(scores)}")
    if not is_consistent(answer.correlations, scores):
        print_line(
            "warning: the fit does not transfer to the pairs held out; check that both images of each pair show the "
            "same touch, and that the order is the same"
        )


def is_consistent(used: Sequence[float], held_out: Sequence[float]) -> bool:
    """Whether the correlations of the pairs fitted to and held out (may be empty) are those of one common map."""
    judged = float(np.mean(held_out if len(held_out) else used))
    return judged > max(_MIN_CORRELATION, _MIN_HELD_OUT_SHARE * float(np.mean(used)))


def _format_correlations(scores: Sequence[float]) -> str:
    low, high = np.percentile(scores, [10, 90])
    return f"mean {np.mean(scores):.3f} (10 to 90 %: {low:.2f} to {high:.2f})"
