"""How accurate is an alignment fitted to a few pairs, without an initial alignment?

    python -m benchmarks.align_fit [DATA_FOLDER]

Tiles of touch2touch (`t2t_pairs`): ten of the training split are fitted to, drawn three times; the others are scored.
The figure is 1 less the partial correlation of expected and real imprint at 128 x 128 px: the mean imprint of the ten
tiles, laid as the gel tile's colours say, is regressed out of both. No tile is scored by what it was fitted to, and no
number of the method was chosen by the split it is quoted on alone: all were looked at while it was made. Baselines: the
mean imprint's own plain correlation, and the published VQ-VAE, which was trained on thousands of pairs.
The round trip carries simulated strokes by known numbers, with noise; errors are the largest of six fits.
The recording is a sample's exact depth of two touches; errors are those of the alignment written.
"""

from __future__ import annotations

import csv
import math
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.harness.results import BenchmarkResult, Measurement
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, summarize_times
from benchmarks.scenes.depth_helpers import recorded_data
from pipeline.alignment.coarse_start import align_rigidly, make_touch_pairs
from pipeline.alignment.refine import refine_alignment
from pipeline.alignment.touches import load_paired_touches
from pipeline.imprints.agreement import compute_correlation
from pipeline.imprints.fitting import fit_pairs, score_fit
from pipeline.imprints.image_rotation import orient_image
from pipeline.imprints.tiles import detect_ridges, load_tile_pairs
from pipeline.imprints.transfer import TransferModel
from pipeline.recordings import image_files
from pipeline.sensors.spec import load_sensor
from pipeline.translation.translate import Request, open_translation
from tests.pipeline.imprints.scenes import pairs as simulated

NEEDS = "recorded data"
SAMPLE = Path(__file__).resolve().parents[1] / "sample_data" / "recordings" / "grasps_lines_120.h5"
DRAWS, USED = 3, 10
SPLITS = {"held-out centres": "Center_Generalization", "training split": "Training"}
TRUE = TransferModel(is_mirrored=True, log_scale=math.log(0.36), right=0.06, down=-0.05, tilt_right=0.3, tilt_down=-0.2)


def tiles(folder: Path) -> tuple[list[Measurement], list[str]]:
    spec = load_sensor("gelslim")
    rows_by_name = {r["base"]: r for r in csv.DictReader((folder / "index.csv").open())}
    found = load_tile_pairs(folder, spec, "*_gelslim.png", "*_bubble_gt.png").pairs
    peers = {p.name: _peer(folder, p.name, spec) for p in found}
    training = [k for k, p in enumerate(found) if rows_by_name[p.name]["split"] == "Training"]
    ours: dict[str, list[float]] = {name: [] for name in (*SPLITS, "tools not among the ten")}
    vqvae, mean, seconds = {name: [] for name in ours}, {name: [] for name in ours}, []
    for seed in range(DRAWS):
        used = set(np.random.default_rng(seed).choice(training, USED, replace=False).tolist())
        tools = {rows_by_name[found[k].name]["tool"] for k in used}
        started = time.process_time()
        answer = fit_pairs([found[k] for k in sorted(used)])
        seconds.append(time.process_time() - started)
        for k in set(range(len(found))) - used:
            one = rows_by_name[found[k].name]
            names = [n for n, split in SPLITS.items() if one["split"] == split]
            names += ["tools not among the ten"] * (one["tool"] not in tools)
            for name in names:
                ours[name].append(score_fit(found[k], answer.transfer, answer.mean_imprint))
                vqvae[name].append(compute_correlation(peers[found[k].name], found[k].imprint, answer.mean_imprint))
                mean[name].append(compute_correlation(answer.mean_imprint, found[k].imprint))
    taken = summarize_times([1e3 * s for s in seconds])
    notes = [f"{name}: the mean imprint alone correlates by {np.mean(mean[name]):.2f}" for name in ours if ours[name]]
    return [
        build_measurement(
            f"touch2touch tiles, {name}: imprint beyond the mean one",
            ours=taken,
            ours_error=1 - np.mean(ours[name]),
            peer="published VQ-VAE",
            peer_error=1 - np.mean(vqvae[name]),
            unit="1 - partial correlation",
            bar=Requirement(max_error=0.45),
        )
        for name in ours
        if ours[name]
    ], notes


def _peer(folder: Path, name: str, spec) -> np.ndarray:
    way = detect_ridges(image_files.read_rgb(folder / f"{name}_gelslim.png"), spec).orientation
    return orient_image(image_files.read_rgb(folder / f"{name}_bubble_vqvae.png")[..., 0], way)


def round_trip() -> tuple[list[Measurement], str]:
    off: dict[str, list[float]] = {"turn": [], "scale": [], "shift": [], "tilt": []}
    in_spread, seconds = [], []
    for turn in np.radians((0, 40, 97, 180, 230, 300)):
        true = replace(TRUE, rotation_rad=float(turn))
        started = time.process_time()
        found = fit_pairs(simulated(true, 6))
        seconds.append(time.process_time() - started)
        how = found.transfer
        turned_by = math.remainder(how.rotation_rad - true.rotation_rad, 2 * math.pi)
        off["turn"].append(math.degrees(abs(turned_by)) if how.is_mirrored == true.is_mirrored else 180.0)
        off["scale"].append(abs(how.scale / true.scale - 1))
        off["shift"].append(math.hypot(how.right - true.right, how.down - true.down))
        off["tilt"].append(math.hypot(how.tilt_right - true.tilt_right, how.tilt_down - true.tilt_down))
        for name in ("log_scale", "right", "down", "tilt_right", "tilt_down"):
            in_spread.append(abs(getattr(how, name) - getattr(true, name)) <= 2 * found.std[name])
    units = {"turn": "deg", "scale": "share", "shift": "tile widths", "tilt": "of the press"}
    bars = {"turn": 1.0, "scale": 0.03, "shift": 0.01, "tilt": 0.05}
    note = f"round trip: {np.mean(in_spread):.0%} of the numbers lie within two of the stated spreads"
    taken = summarize_times([1e3 * s for s in seconds])
    return [
        build_measurement(
            f"round trip of known pairs, {name}",
            ours=taken,
            ours_error=max(off[name]),
            unit=units[name],
            bar=Requirement(max_error=bars[name]),
        )
        for name in off
    ], note


def recording() -> list[Measurement]:
    translation = open_translation(Request(recording=SAMPLE, source="gelslim", target="soft_bubble"))
    touches = [
        t for t in load_paired_touches(translation, range(translation.n_frames), exact=True) if t.has_contact_on_both
    ][:2]
    started = time.process_time()
    start = align_rigidly(touches, fit_pairs(make_touch_pairs(touches).pairs).transfer, translation.alignment)
    found = refine_alignment(touches, start).alignment.target_from_source
    taken = summarize_times([1e3 * (time.process_time() - started)])
    exact = translation.alignment.target_from_source
    turn = math.degrees(math.acos(min(1.0, (np.trace(found[:3, :3].T @ exact[:3, :3]) - 1) / 2)))
    shift = float(np.linalg.norm(found[:3, 3] - exact[:3, 3]))
    translation.close()
    asked = "alignment of two touches from nothing, exact depth"
    return [
        build_measurement(f"{asked}, shift", ours=taken, ours_error=shift, unit="mm", bar=Requirement(max_error=0.3)),
        build_measurement(f"{asked}, turn", ours=taken, ours_error=turn, unit="deg", bar=Requirement(max_error=1.0)),
    ]


def measure(data: str = "") -> BenchmarkResult:
    """Rows of tiles, of the round trip and of a recording; times are of the processor."""
    of_tiles, notes = tiles(recorded_data(data) / "t2t_pairs")
    of_known, note = round_trip()
    return BenchmarkResult(
        title="How two sensors stand to each other, from a few pairs and nothing to begin with",
        unit="1 - partial correlation",
        rows=(*of_tiles, *of_known, *recording()),
        notes=(*notes, note),
    )


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:2]))
