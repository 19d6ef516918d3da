"""How long does a touch by compact diffusion take: the network alone, and all that is done for a new frame?

    python benchmarks/diffusion_time.py [long]

A GelSlim's picture of a star to a bubble's touch (T2T), and a bubble's reading to a GelSlim's (T2D2), by the weights
that come along. Milliseconds are of the processor, on one thread: on a quiet machine those of the clock. Touch to touch
is asked without caution, so that no physics is in its time; that of T2D2 begins at the view, with its physical render
known. The peer of the last rows is the paper's setting, 200 steps guided by 2.54, of the same network, which `long`
runs in full; without it 20 of its steps are taken for a tenth of them. The error of these rows is how much less alike
(SSIM) the touch is to the true one than the peer's.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.image_similarity import compute_similarity
from benchmarks.timing import Requirement, Timing, build_measurement, summarize_times
from pipeline.networks.network_factory import load_network
from pipeline.networks.weights import NoWeights
from pipeline.physics import optics
from pipeline.racing.results import BenchmarkResult, Measurement
from pipeline.racing.text_report import print_result
from pipeline.sensors import alignment
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import poses, shapes
from pipeline.simulation.press import simulate_press
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.stages.target_depth.surface_projection import SurfaceProjectionParams, project_cloud
from pipeline.stages.touch import t2d2, t2t
from pipeline.stages.touch.residual_diffusion import DiffusionParams, sample_residual
from pipeline.values.frames import TactileFrame

THING, RUNS = "star", 7
ONE_MS, EIGHT_MS, FASTER, ALIKE = 50.0, 250.0, 50.0, 0.005
PLAIN = DiffusionParams(confidence_weighting=0.0)
PAPER = replace(PLAIN, steps=200, guidance=2.54)


def measure(long: str = "") -> BenchmarkResult:
    import torch

    torch.set_num_threads(1)
    rows: list[Measurement] = []
    notes: list[str] = []
    for name, method, source, target in (
        ("T2T", "t2t", "gelslim", "soft_bubble"),
        ("T2D2", "t2d2", "soft_bubble", "gelslim"),
    ):
        _asked(name, method, load_sensor(source), load_sensor(target), bool(long), rows, notes)
    return BenchmarkResult(title="time of compact diffusion", unit="SSIM", rows=tuple(rows), notes=tuple(notes))


def _asked(name, method, source, target, long, rows, notes) -> None:
    module = t2t if method == "t2t" else t2d2
    weights = module.select_weights(source, target, None)
    if isinstance(weights, NoWeights):
        notes.append(f"{name}, {source.name} to {target.name}: {weights.why}")
        return
    net, frame, truth = load_network(weights), *_pressed(source, target)
    between = alignment.resolve_alignment(source, target)
    if method == "t2t":
        shown = t2t.build_condition(frame, source, between, target)

        def whole(params):
            return t2t.generate_touch(frame, source, None, between, target, net, params)
    else:
        view = project_cloud(
            back_project_depth(estimate_depth(frame, source, None, DepthParams()), between, BackProjectionParams()),
            target,
            SurfaceProjectionParams(),
        )
        physical = t2d2.generate_touch(view, target, net, replace(PLAIN, steps=0))
        shown = t2d2.build_condition(view, physical.membrane, target)

        def whole(params):
            return t2d2.generate_touch(view, target, net, params)

    way, few = f"{name}, {source.name} to {target.name}", {}
    for steps, most in ((1, ONE_MS), (8, EIGHT_MS)):
        params = replace(PLAIN, steps=steps)
        alone, every = _timed(lambda p=params: sample_residual(net, shown, p)), _timed(lambda p=params: whole(p))
        few[steps] = alone, _alike(whole(params), truth, target)
        for what, taken in (("network alone", alone), ("whole touch", every)):
            rows.append(
                build_measurement(
                    f"{way}, {steps} steps: {what}", ours=taken, ours_error=0.0, unit="", bar=Requirement(max_ms=most)
                )
            )
    shorter = PAPER if long else replace(PAPER, steps=20)
    times = PAPER.steps / shorter.steps
    spent = _timed(lambda: sample_residual(net, shown, shorter), 1)
    theirs = Timing(median_ms=times * spent.median_ms, p95_ms=times * spent.p95_ms)
    alike = _alike(whole(shorter), truth, target)
    for steps, (taken, ours) in few.items():
        bar = Requirement(min_speedup=FASTER, max_error=ALIKE) if steps == 1 else Requirement(max_error=ALIKE)
        rows.append(build_measurement(
            f"{way}, {steps} steps beside 200 guided", peer="the paper's setting", ours=taken, peer_timing=theirs,
            ours_error=max(0.0, alike - ours), peer_error=0.0, unit="SSIM", bar=bar,
        ))  # fmt: skip
    told = ", ".join(f"{steps} steps {v[1]:.4f}" for steps, v in few.items())
    short = "" if long else "; its time is ten times that of 20 steps"
    notes.append(f"{way}: SSIM {told}, {shorter.steps} guided {alike:.4f}{short}")


def _timed(call, runs: int = RUNS) -> Timing:
    taken = []
    if runs > 1:
        call()
    for _ in range(runs):
        started = time.process_time()
        call()
        taken.append(1e3 * (time.process_time() - started))
    return summarize_times(taken)


def _pressed(source, target):
    """A frame of the source, and what the target pictures of the same press."""
    thing = shapes.make_shape(THING).mesh
    pose = poses.sample_press_pose(thing, np.random.default_rng(5))
    felt, own = simulate_press(thing, pose, source, seed=1), simulate_press(thing, pose, target, seed=None)
    still = optics.render_reference(source) if source.kind == "gel" else source.rest_depth_mm.astype(np.float32)
    return TactileFrame(sensor=source.name, image=felt.image, reference=still), own.image


def _alike(touch, truth, target) -> float:
    span = 255.0 if target.kind == "gel" else 22.5
    return compute_similarity(np.asarray(touch.image, float), np.asarray(truth, float), span)


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:]))
