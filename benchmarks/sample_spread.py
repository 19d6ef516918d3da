"""Are samples of the diffusion methods samples: does their spread over seeds say how far off they are?

    python benchmarks/sample_spread.py [METHOD] [SOURCE:TARGET] [SPLIT] [PLOT.png] [RECORDINGS_FOLDER] [GUIDANCE]

Held-out touches of `tactoscope evaluate` (two grasps of each object, or four of each unseen tool) are sampled with some
seeds in eight steps. Were the samples draws of what the condition allows, two of them would lie as far apart as one
lies from the truth, and where the spread is some size the error of their mean would be nearly so large. Sets of
touches are compared by the Frechet distance of `tactoscope evaluate`: the sample of one seed, the answer in one step
(the middle of all samples, nothing held back) and what either begins with, beside two halves of the true touches.
"""

from __future__ import annotations

import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.timing import Requirement, build_measurement, summarize_times
from pipeline.base.files import whole_file
from pipeline.evaluation import touch_features
from pipeline.evaluation.held_out import HeldOutOptions, load_or_simulate
from pipeline.evaluation.paper_tables import parse_direction
from pipeline.evaluation.recorded_touch import build_recorded_touch, compute_generated_change
from pipeline.metrics import set_distances
from pipeline.networks.weights import NoWeights
from pipeline.racing.results import BenchmarkResult
from pipeline.racing.text_report import print_result
from pipeline.recordings import open_recording
from pipeline.sensors.spec import load_sensor
from pipeline.translation.catalogue import BUILT_IN, default_params
from pipeline.translation.translate import Request, open_translation

SEEDS, STEPS, PARTS = 5, 8, 5
GRASPS = {"unseen_grasps": 2, "unseen_tools": 4}


class SampleStatistics:
    """What is added up over touches."""

    def __init__(self) -> None:
        self.spread: list[np.ndarray] = []
        self.off: list[np.ndarray] = []
        self.said: list[np.ndarray] = []
        self.apart: list[float] = []
        self.astray: list[float] = []
        self.seen: dict[str, list[np.ndarray]] = {"sample": [], "one step": [], "begun with": [], "true": []}
        self.ms: list[float] = []


def measure_direction(
    method: str, source: str, target: str, split: str, folder: str = "", guidance: float = 1.0
) -> SampleStatistics:
    found = SampleStatistics()
    held_out = HeldOutOptions(grasps=GRASPS[split], folder=Path(folder) if folder else None)
    for presses in load_or_simulate(split, held_out):
        request = Request(recording=presses.source, source=source, target=target, methods=(("touch", method),))
        with closing(open_translation(request)) as opened, closing(open_recording(presses.target)) as other:
            both = replace(opened.recording, streams=(opened.recording.stream(source), other.stream(target)))
            one = replace(opened, recording=both)
            for index in range(one.n_frames):
                _touch(found, one, index, guidance)
    return found


def _touch(found: SampleStatistics, one, index: int, guidance: float) -> None:
    true = build_recorded_touch(*one.read_target_observation(index))
    usual = default_params(one.methods)
    plain, graph = replace(usual["touch"], caution=0.0), one.graph()

    def touch(params):
        return graph.evaluate(["touch"], one.inputs(index), {**usual, "touch": params})["touch"].output

    def add_features(what, made):
        feature = touch_features.encode_change(one.target, compute_generated_change(made, one.target))
        if feature is not None:
            found.seen[what].append(feature)

    middle, samples = touch(plain), []
    if middle.membrane is None or middle.membrane.spread_mm is None:
        return  # physics answered: nothing was felt
    for seed in range(SEEDS):
        started = time.perf_counter()
        samples.append(touch(replace(plain, steps=STEPS, seed=seed, guidance=guidance)))
        found.ms.append(1e3 * (time.perf_counter() - started))
    stack = np.stack([s.membrane.indentation_mm for s in samples])
    where = true.contact | (np.abs(stack).max(0) > 0.02 * stack.max())  # where nothing ever is, nothing is to be told
    found.spread.append(stack.std(0, ddof=1)[where])
    found.off.append(np.abs(stack.mean(0) - true.indentation_mm)[where])
    found.said.append(middle.membrane.spread_mm[where])
    found.apart.append(float(np.abs(stack[1:] - stack[:-1])[:, where].mean()))
    found.astray.append(float(np.abs(stack - true.indentation_mm)[:, where].mean()))
    add_features("sample", samples[0])
    add_features("one step", middle)
    add_features("begun with", touch(replace(plain, steps=0)))
    add_features("true", _own(one, true))


def _own(one, true):
    from pipeline.stages.touch.touch_from_change import make_touch_from_change

    return make_touch_from_change(one.target, true.change)


def by_parts(guess: np.ndarray, off: np.ndarray) -> list[tuple[float, float]]:
    """(mean guess, mean error) of as many pixels each, in the order of the guess."""
    return [(float(guess[p].mean()), float(off[p].mean())) for p in np.array_split(np.argsort(guess), PARTS)]


def measure(
    method: str = "t2t", way: str = "gelslim:soft_bubble", split: str = "unseen_tools", plot: str = "",
    folder: str = "", guidance: str = "1",
) -> BenchmarkResult:  # fmt: skip
    source, target = parse_direction(way)
    known = BUILT_IN.method("touch", method).weights(load_sensor(source), load_sensor(target), None)
    if isinstance(known, NoWeights):
        return BenchmarkResult(title="spread of samples", unit="mm", rows=(), notes=(known.why,))
    found = measure_direction(method, source, target, split, folder, float(guidance))
    spread, off, said = (np.concatenate(v) for v in (found.spread, found.off, found.said))
    parts = {"spread over seeds": by_parts(spread, off), "spread that one step tells": by_parts(said, off)}
    notes = [f"{name} against the error of the samples' mean, by fifths of the pixels, mm: "
             + ", ".join(f"{a:.2g}/{b:.2g}" for a, b in told) for name, told in parts.items()]  # fmt: skip
    notes.append(
        f"two samples lie {np.mean(found.apart):.3g} mm apart, a sample {np.mean(found.astray):.3g} mm from the truth, "
        f"where anything is; correlation of spread and error {np.corrcoef(spread, off)[0, 1]:.2f}"
    )
    true = np.array(found.seen.pop("true"))
    if len(true) >= 2 * set_distances.FEWEST:
        told = {
            k: set_distances.compare_halves(set_distances.frechet_distance, np.array(v), true)
            for k, v in found.seen.items()
            if v
        }
        floor = set_distances.compute_floor(set_distances.frechet_distance, true)
        notes.append("Frechet distance: " + ", ".join(f"{k} {v:.3g}" for k, v in told.items())
                     + f"; two halves of the true touches {floor:.3g}")  # fmt: skip
    if plot:
        _draw(parts, Path(plot), f"{method}, {source} to {target}, {split.replace('_', ' ')}")
    one = build_measurement(f"{method}, {source} to {target}, {split}: sample from truth", ours=summarize_times(found.ms), unit="mm",
              ours_error=float(np.mean(found.astray)), bar=Requirement())  # fmt: skip
    return BenchmarkResult(title="spread of samples", unit="mm", rows=(one,), notes=tuple(notes))


def _draw(parts, path: Path, title: str) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.6, 4.8), dpi=120, layout="constrained")
    canvas, axes = FigureCanvasAgg(figure), figure.add_subplot()
    for name, told in parts.items():
        axes.plot(*zip(*told, strict=True), "o-", label=name)
    most = 1.1 * max(max(pair) for told in parts.values() for pair in told)
    axes.plot([0, most], [0, most], ":", color="0.5", label="as large as the error")
    axes.set(title=title, xlabel="spread, mm", ylabel="error of the samples' mean, mm")
    axes.grid(visible=True, alpha=0.3)
    axes.legend(fontsize=8)
    with whole_file(path, "the plot") as file:
        canvas.print_png(file)


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:]))
