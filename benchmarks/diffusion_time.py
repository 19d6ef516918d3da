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

from benchmarks.likeness import similarity
from benchmarks.races import Bar, Timing, row, timing
from pipeline.networks.building import network
from pipeline.networks.weights import NoWeights
from pipeline.physics import optics
from pipeline.racing.races import Answer, Row
from pipeline.racing.report import show
from pipeline.sensors import alignment
from pipeline.sensors.spec import sensor
from pipeline.simulation import poses, shapes
from pipeline.simulation.press import press
from pipeline.stages.adapt.stage import AdaptParams, adapt
from pipeline.stages.depth.stage import DepthParams, depth
from pipeline.stages.generate import picture_to_touch, view_to_touch
from pipeline.stages.generate.diffusion import DiffusionParams, sampled
from pipeline.stages.project.stage import ProjectParams, project
from pipeline.values.frames import TactileFrame

THING, RUNS = "star", 7
ONE_MS, EIGHT_MS, FASTER, ALIKE = 50.0, 250.0, 50.0, 0.005
PLAIN = DiffusionParams(caution=0.0)
PAPER = replace(PLAIN, steps=200, guidance=2.54)


def answer(long: str = "") -> Answer:
    import torch

    torch.set_num_threads(1)
    rows: list[Row] = []
    notes: list[str] = []
    for name, method, source, target in (
        ("T2T", "t2t", "gelslim", "soft_bubble"),
        ("T2D2", "t2d2", "soft_bubble", "gelslim"),
    ):
        _asked(name, method, sensor(source), sensor(target), bool(long), rows, notes)
    return Answer(title="time of compact diffusion", unit="SSIM", rows=tuple(rows), notes=tuple(notes))


def _asked(name, method, source, target, long, rows, notes) -> None:
    module = picture_to_touch if method == "t2t" else view_to_touch
    weights = module.weights(source, target, None)
    if isinstance(weights, NoWeights):
        notes.append(f"{name}, {source.name} to {target.name}: {weights.why}")
        return
    net, frame, truth = network(weights), *_pressed(source, target)
    between = alignment.between(source, target)
    if method == "t2t":
        shown = picture_to_touch.condition(frame, source, between, target)

        def whole(params):
            return picture_to_touch.generate(frame, source, None, between, target, net, params)
    else:
        view = project(
            adapt(depth(frame, source, None, DepthParams()), between, AdaptParams()), target, ProjectParams()
        )
        physical = view_to_touch.generate(view, target, net, replace(PLAIN, steps=0))
        shown = view_to_touch.condition(view, physical.membrane, target)

        def whole(params):
            return view_to_touch.generate(view, target, net, params)

    way, few = f"{name}, {source.name} to {target.name}", {}
    for steps, most in ((1, ONE_MS), (8, EIGHT_MS)):
        params = replace(PLAIN, steps=steps)
        alone, every = _timed(lambda p=params: sampled(net, shown, p)), _timed(lambda p=params: whole(p))
        few[steps] = alone, _alike(whole(params), truth, target)
        for what, taken in (("network alone", alone), ("whole touch", every)):
            rows.append(row(f"{way}, {steps} steps: {what}", ours=taken, ours_error=0.0, unit="", bar=Bar(ms=most)))
    shorter = PAPER if long else replace(PAPER, steps=20)
    times = PAPER.steps / shorter.steps
    spent = _timed(lambda: sampled(net, shown, shorter), 1)
    theirs = Timing(median_ms=times * spent.median_ms, p95_ms=times * spent.p95_ms)
    alike = _alike(whole(shorter), truth, target)
    for steps, (taken, ours) in few.items():
        bar = Bar(faster=FASTER, error=ALIKE) if steps == 1 else Bar(error=ALIKE)
        rows.append(row(
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
    return timing(taken)


def _pressed(source, target):
    """A frame of the source, and what the target pictures of the same press."""
    thing = shapes.shape(THING).mesh
    pose = poses.single(thing, np.random.default_rng(5))
    felt, own = press(thing, pose, source, seed=1), press(thing, pose, target, seed=None)
    still = optics.untouched(source) if source.kind == "gel" else source.rest_depth_mm.astype(np.float32)
    return TactileFrame(sensor=source.name, image=felt.image, reference=still), own.image


def _alike(touch, truth, target) -> float:
    span = 255.0 if target.kind == "gel" else 22.5
    return similarity(np.asarray(touch.image, float), np.asarray(truth, float), span)


if __name__ == "__main__":
    show(answer(*sys.argv[1:]))
