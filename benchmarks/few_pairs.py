"""What do ten and thirty real pairs teach the weights of simulated touch to touch?

    python benchmarks/few_pairs.py [DATA_FOLDER] [WEIGHTS] [DRAWS] [10 | 30]

Tiles of touch2touch (`t2t_pairs`): so many of the training split are learned from, drawn three times, each time by two
networks that saw them in another order; what is expected is their mean, and what one of them alone says stands beside.
All other tiles are scored by the partial correlation of expected and real imprint at 128 x 128 px, the mean imprint of
those learned from regressed out of both (a mean imprint alone has 0 there). Beside it: the simulated weights before any
real pair, and the physical fit of the same pairs (`align_fit`), which also says where a gel's tile lies in a bubble's.
What is learned here is not kept. Tiles are stretched each by itself and jittered in colour, so that likeness is learned
and no depth, with colours mixed. Loss, rate, steps, looks, and how much of the fit is added, were chosen on draws of
other seeds, two networks before any was scored.
"""

from __future__ import annotations

import csv
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.data_folder import recorded_data
from benchmarks.timing import Requirement, build_measurement, summarize_times
from pipeline.alignment.fit.agreement import compute_correlation
from pipeline.alignment.fit.difference_tiles import ridges
from pipeline.alignment.fit.fitting import PairsFit, fit_pairs, score_fit
from pipeline.alignment.fit.image_rotation import rotate_image
from pipeline.alignment.fit.pairs import tile_pairs
from pipeline.alignment.fit.transfer import transfer_imprint
from pipeline.geometry import rigid
from pipeline.geometry.camera import Camera
from pipeline.networks import weights_registry
from pipeline.networks.network_factory import load_network
from pipeline.networks.weights import load_weights as load_weights
from pipeline.racing.results import BenchmarkResult
from pipeline.racing.text_report import print_result
from pipeline.recordings import image_files
from pipeline.sensors import alignment
from pipeline.sensors.spec import load_sensor
from pipeline.stages.touch.image_condition import build_image_condition
from pipeline.training.export import export_run
from pipeline.training.loop import TrainingRun, train
from pipeline.training.pair_files import TrainingPair, save_pair
from pipeline.training.recipe import load_recipe

NEEDS = "recorded data"
RECIPE, WEIGHTS = "t2t_few_pairs", "t2t_bubble"
DRAWS, SEEDS = (0, 1, 2), (1, 2)
BARS = {10: 0.60, 30: 0.75}
STEPS, RATE, ALIKE, MIXED = {10: 350, 30: 700}, 1e-3, 1.0, 0.25
LOOKS = ((0, 0, 0), (3, 0, 3), (-3, 0, -3), (0, 3, -3), (0, -3, 3))  # px, px, deg: what is expected is their mean
SIDE = 128
_STRONG_GREY, _DEEP_MM = 60.0, 6.0  # what the strongest of a tile stands for: tiles are stretched in grey levels
_LOW, _HIGH, _TOUCHED = 2.0, 99.5, 0.35
_PHYSICS = 0.5  # of the fit, beside the network, both of spread 1


def align_tile_pair(picture: np.ndarray, way: int, spec, imprint: np.ndarray, found: PairsFit) -> TrainingPair:
    """A pair of tiles as simulated ones are drawn: half a turn from each other, pixels of the bubble's own size."""
    gel, bubble = spec, load_sensor("soft_bubble")
    tile = rotate_image(picture, way).astype(np.float32)
    change = tile - np.median(tile.reshape(-1, 3), axis=0)
    change *= _STRONG_GREY / max(float(np.percentile(np.abs(change), _HIGH)), 1.0)
    eye = Camera(
        rows=SIDE, cols=SIDE, cx_px=(SIDE - 1) / 2, cy_px=(SIDE - 1) / 2,
        fx_px=gel.camera.fx_px * SIDE / gel.camera.cols, fy_px=gel.camera.fy_px * SIDE / gel.camera.rows,
    )  # fmt: skip
    both = alignment.resolve_alignment(gel, bubble)
    rest = float(np.median(gel.rest_depth_mm))
    middle = rigid.apply(both.target_from_source, np.array([[0.0, 0.0, rest]]))[0]
    per_px = rest * bubble.camera.fx_px / middle[2] / found.carrying.scale
    cols, rows = round(per_px * SIDE / eye.fx_px), round(per_px * SIDE / eye.fy_px)
    seen = Camera(
        rows=rows, cols=cols, fx_px=bubble.camera.fx_px, fy_px=bubble.camera.fy_px,
        cx_px=(0.5 - found.carrying.right) * cols - 0.5 - bubble.camera.fx_px * middle[0] / middle[2],
        cy_px=(0.5 - found.carrying.down) * rows - 0.5 - bubble.camera.fy_px * middle[1] / middle[2],
    )  # fmt: skip
    shown = build_image_condition(change, eye, gel, bubble.with_camera(seen), both)
    low, high = np.percentile(imprint, (_LOW, _HIGH))
    share = np.clip((imprint - low) / max(float(high - low), 1e-6), 0.0, 1.2)
    touch = _DEEP_MM * _sized(rotate_image(share, 2), (rows, cols))
    return TrainingPair(condition=shown, indentation_mm=touch, contact=touch > _TOUCHED * _DEEP_MM)


def predict_imprint(net, one: TrainingPair) -> np.ndarray:
    """The imprint (SIDE, SIDE) in one step, the mean of some looks at it, laid as the tile is."""
    import cv2
    import torch

    rows, cols = one.contact.shape
    found = np.zeros((rows, cols), np.float32)
    for across, down, turn in LOOKS:
        how = cv2.getRotationMatrix2D(((cols - 1) / 2, (rows - 1) / 2), turn, 1.0)
        how[:, 2] += across, down
        with torch.inference_mode():
            told = torch.from_numpy(np.stack([_moved(channel, how) for channel in one.condition]))[None]
            made = net(torch.zeros(1, 2, rows, cols), torch.full((1,), float(net.most)), told)[0, 0].numpy()
        found += _moved(made, cv2.invertAffineTransform(how)) / len(LOOKS)
    return rotate_image(_sized(found, (SIDE, SIDE)), 2)


def _moved(field: np.ndarray, how: np.ndarray) -> np.ndarray:
    import cv2

    whole = np.ascontiguousarray(field, np.float32)
    return np.asarray(cv2.warpAffine(whole, how, whole.shape[::-1], borderMode=cv2.BORDER_REPLICATE), np.float32)


def fine_tune(folder: Path, begin: Path, pairs: int, seed: int):
    """The network once it has seen the first pairs of a folder, in the order of that seed."""
    recipe = load_recipe(RECIPE, "t2t")
    recipe = replace(
        recipe,
        settings=replace(recipe.settings, folder=str(folder), pairs=pairs, alike=ALIKE, mixed=MIXED),
        pace=replace(recipe.training, begin=str(begin), steps=STEPS[pairs], precision="bf16", seed=seed),
        optimiser=replace(recipe.optimiser, learning_rate=RATE),
    )
    out = folder / f"run_{seed}"
    train(TrainingRun(recipe=recipe, folder=out, n_workers=0))
    export_run(out, out / "weights.safetensors")
    return load_network(load_weights(out / "weights.safetensors"))


def tiles(folder: Path, begin: Path, draws=DRAWS, counts=tuple(BARS)) -> tuple[list, list[str]]:
    spec = load_sensor("gelslim")
    told = {r["base"]: r for r in csv.DictReader((folder / "index.csv").open())}
    found = tile_pairs(folder, spec, "*_gelslim.png", "*_bubble_gt.png").pairs
    training = [k for k, p in enumerate(found) if told[p.name]["split"] == "Training"]
    seen = [image_files.read_rgb(folder / f"{p.name}_gelslim.png") for p in found]
    ways_laid = [ridges(picture, spec).way for picture in seen]
    rows, notes = [], []
    for pairs, bar in ((n, BARS[n]) for n in counts):
        ways = {name: [] for name in ("ours", "alone", "physics", "together", "before")}
        plain, seconds, held, by_draw = [], [], [], []
        for seed in draws:
            used = sorted(np.random.default_rng(seed).choice(training, pairs, replace=False).tolist())
            rest = [k for k in range(len(found)) if k not in used]
            answer = fit_pairs([found[k] for k in used])
            drawn = {k: align_tile_pair(seen[k], ways_laid[k], spec, found[k].imprint, answer) for k in (*used, *rest)}
            with tempfile.TemporaryDirectory() as kept:
                for number, k in enumerate((*used, *rest)):
                    save_pair(Path(kept), number, drawn[k])
                started = time.process_time()
                nets = [fine_tune(Path(kept), begin, pairs, seed) for seed in SEEDS]
                seconds.append(1e3 * (time.process_time() - started))
            first = load_network(load_weights(begin))
            for k in rest:
                one, true = found[k], found[k].imprint
                each = [predict_imprint(net, drawn[k]) for net in nets]
                made, fitted = np.mean(each, axis=0), _sized(transfer_imprint(one, answer.carrying), (SIDE, SIDE))
                ways["alone"].append(
                    float(np.mean([compute_correlation(one_s, true, answer.common) for one_s in each]))
                )
                ways["ours"].append(compute_correlation(made, true, answer.common))
                both = made / made.std() + _PHYSICS * fitted / max(float(fitted.std()), 1e-9)
                ways["together"].append(compute_correlation(both, true, answer.common))
                ways["before"].append(compute_correlation(predict_imprint(first, drawn[k]), true, answer.common))
                ways["physics"].append(score_fit(one, answer.carrying, answer.common))
                plain.append(compute_correlation(answer.common, true))
                held.append(told[one.name]["split"] != "Training")
            by_draw.append({name: float(np.mean(values[-len(rest) :])) for name, values in ways.items()})
            print(f"{pairs} pairs, draw {seed}:", {n: round(v, 3) for n, v in by_draw[-1].items()}, file=sys.stderr)
        means = {name: float(np.mean(values)) for name, values in ways.items() if values}
        centres = float(np.mean(np.array(ways["ours"])[held]))
        rows.append(build_measurement(f"{pairs} real pairs, the other {len(found) - pairs} tiles", ours=summarize_times(seconds),
                        ours_error=1 - means["ours"], peer="physical fit of the same pairs",
                        peer_error=1 - means["physics"], unit="1 - partial correlation",
                        bar=Requirement(max_error=1 - bar)))  # fmt: skip
        notes.append(
            f"{pairs} pairs: {means['ours']:.3f} beyond the mean imprint (worst draw "
            f"{min(one['ours'] for one in by_draw):.3f}, held-out centres alone {centres:.3f}), one network alone "
            f"{means['alone']:.3f}, simulated weights alone {means['before']:.3f}, physical fit "
            f"{means['physics']:.3f}, network and half as much of the fit {means['together']:.3f}; the mean imprint "
            f"itself correlates plainly by {np.mean(plain):.2f}"
        )
    return rows, notes


def _sized(field: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    import cv2

    how = cv2.INTER_AREA if shape[0] < field.shape[0] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(np.ascontiguousarray(field), shape[::-1], interpolation=how), np.float32)


def measure(data: str = "", weights: str = "", draws: str = "", count: str = "") -> BenchmarkResult:
    begin = Path(weights) if weights else weights_registry.WEIGHTS_FOLDER / f"{WEIGHTS}.safetensors"
    seeds, counts = DRAWS[: int(draws or len(DRAWS))], (int(count),) if count else tuple(BARS)
    rows, notes = tiles(recorded_data(data) / "t2t_pairs", begin, seeds, counts)
    return BenchmarkResult(
        title="Touch to touch after a few real pairs", unit="1 - partial correlation", rows=tuple(rows),
        notes=tuple(notes),
    )  # fmt: skip


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:5]))
