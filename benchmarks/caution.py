"""How many times as far off as it says does a network have to be taken for, so that it falls back where it should?

    python benchmarks/caution.py [t2t | t2d2] [SOURCE:TARGET] [WEIGHTS.safetensors] [TOUCHES]

Training objects, held anew, and random bodies that no weights were learned from are pressed on another unit of the
source, and so are the objects of the downstream tasks (a key, a spanner, a pencil, ...), which nothing was learned from
and no table holds; its reading goes the whole way to the target's touch, in one step. A doubt of 0 takes all that the
network says; `power` is that of the error told (`doubt_power`). The weights carry those whose errors are least in the
mean of both kinds of objects, those that the network knows the like of and those that it does not: where the source
felt (`doubt`) and beyond (`doubt_beyond`). What is farther off than physics counts twice by as much as it is.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.residual_diffusion import _described, _read
from pipeline.networks.building import network
from pipeline.networks.weights import load
from pipeline.physics import bubble_camera, optics
from pipeline.racing.races import Answer
from pipeline.racing.report import show
from pipeline.scoring.evaluation import direction
from pipeline.sensors import alignment
from pipeline.simulation import poses, shapes
from pipeline.simulation.press import press
from pipeline.simulation.variation import varied
from pipeline.stages.adapt.stage import AdaptParams, adapt
from pipeline.stages.generate import picture_to_touch, stage, view_to_touch
from pipeline.stages.generate.caution import Trust, against, held_back
from pipeline.stages.generate.corrected import on_grid
from pipeline.stages.generate.diffusion import DiffusionParams, Sampled, sampled
from pipeline.stages.project.stage import ProjectParams, project
from pipeline.training.own_touches import thing_of
from pipeline.values.frames import TactileFrame

TOUCHES, SEED, UNITS = 60, 2929, 7000
DOUBTS = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0)  # times an error of a third of the network's unit
POWERS = (1.0, 1.5, 2.0, 2.5)
HARM = 1.0  # an error where physics had less counts so much more: caution is there to do no harm
REGIONS = ("in contact", "over all", "where the source felt", "beyond")
FELT, BEYOND = 2, 3
GROUPS = ("learned", "task")
SENSORS = ("soft_bubble", "gelslim", "gelsight_mini", "digit")  # each of them another unit


@dataclass(frozen=True, slots=True)
class _Asked:
    """One touch: what the network corrects and says of its error, what it begins with, the truth, where it was felt."""

    found: Sampled
    unit_mm: float
    begun_mm: np.ndarray
    truth_mm: np.ndarray
    known: np.ndarray
    contact: np.ndarray

    def off(self, felt: float, beyond: float, power: float) -> np.ndarray:
        """In contact, over all, where the source felt, beyond; mm."""
        larger = 3.0 ** (power - 1.0)
        trusted = Trust(felt=felt * larger, beyond=beyond * larger, power=power, unit_mm=self.unit_mm)
        return self._off(held_back(self.found, self.known, 1.0, trusted).last.residual_mm)

    def by_physics(self) -> np.ndarray:
        """The same of what it begins with."""
        return self._off(np.zeros_like(self.begun_mm))

    def _off(self, kept: np.ndarray) -> np.ndarray:
        gap = np.abs(self.begun_mm + kept - self.truth_mm)
        known = on_grid(self.known, gap.shape) > 0.5
        regions = (on_grid(self.contact, gap.shape) > 0.5, np.ones_like(known), known, ~known)
        return np.array([float(gap[region].mean()) if region.any() else np.nan for region in regions])


def answer(
    method: str = "t2t", way: str = "gelslim:soft_bubble", file: str = "", touches: str = str(TOUCHES)
) -> Answer:
    source, target = (_described(name) for name in direction(way))
    module = picture_to_touch if method == "t2t" else view_to_touch
    net = network(load(Path(file)) if file else module.weights(source, target, None))
    notes, every = [f"errors in mm {', '.join(REGIONS)}"], []
    for group in GROUPS:
        kept = [f for k in range(int(touches)) if (f := _asked(net, method, source, target, group, k)) is not None]
        what = "task objects" if group == "task" else "training objects held anew, random bodies"
        notes.append(f"{what}, {len(kept)} touches: physics {_said([one.by_physics() for one in kept])}, network "
                     f"{_said([one.off(0.0, 0.0, 1.0) for one in kept])}")  # fmt: skip
        every.append(kept)
    found = sorted((_chosen(every, power) for power in POWERS), key=lambda one: one[0])
    for cost, power, felt, beyond in found:
        told = "; ".join(_said([one.off(felt, beyond, power) for one in kept]) for kept in every)
        larger = 3.0 ** (power - 1.0)
        notes.append(f"power {power:g}: doubt {felt * larger:.3g}, beyond {beyond * larger:.3g}: {told} ({cost:.4g})")
    return Answer(title=f"caution of {method}, {way}", unit="mm", rows=(), notes=tuple(notes))


def _chosen(groups, power: float) -> tuple[float, float, float, float]:
    """(cost over all, power, doubt where it felt, doubt beyond), each doubt that which costs least there."""
    table = {d: [np.array([one.off(d, d, power) for one in kept]) for kept in groups] for d in DOUBTS}
    physics = [np.array([one.by_physics() for one in kept]) for kept in groups]

    def cost(off, region: int) -> float:
        each = [
            o[:, region] + HARM * np.maximum(o[:, region] - p[:, region], 0.0)
            for o, p in zip(off, physics, strict=True)
        ]
        return float(np.mean([np.nanmean(one) if np.isfinite(one).any() else 0.0 for one in each]))

    felt, beyond = (min(table, key=lambda d, r=region: cost(table[d], r)) for region in (FELT, BEYOND))
    both = [np.array([one.off(felt, beyond, power) for one in kept]) for kept in groups]
    return cost(both, 1), power, felt, beyond


def _said(off) -> str:
    return "/".join(f"{np.nanmean(region):.3g}" if np.isfinite(region).any() else "-" for region in np.array(off).T)


def _asked(net, method: str, source, target, group: str, k: int) -> _Asked | None:
    rng = np.random.default_rng([SEED, k])
    thing = thing_of("learned", rng, k) if group == "learned" else _task(k)
    pose = poses.single(thing, rng)
    unit = varied(source, UNITS + 10 * k + SENSORS.index(source.name))
    reading, true = press(thing, pose, unit, seed=2 * k), press(thing, pose, target, seed=None).truth
    if not reading.truth.contact.any() or not true.contact.any():
        return None
    untouched = unit.rest_depth_mm if unit.kind == "bubble" else None
    reference = optics.untouched(unit) if untouched is None else bubble_camera.reading(unit, untouched, 2 * k + 1)
    frame, stand = TactileFrame(sensor=source.name, image=reading.image, reference=reference), alignment.between(
        source, target
    )  # fmt: skip
    view = project(adapt(_read(frame, source), stand, AdaptParams()), target, ProjectParams())
    if not view.contact.any():
        return None
    physical = stage.generate(view, target, stage.GenerateParams()).membrane
    if method == "t2t":
        found = against(
            sampled(net, picture_to_touch.condition(frame, source, stand, target), DiffusionParams()), physical
        )
    else:
        found = sampled(net, view_to_touch.condition(view, physical, target), DiffusionParams())
    shape = found.spread_mm.shape
    return _Asked(
        found, float(net.unit_mm), on_grid(physical.indentation_mm, shape), on_grid(true.indentation_mm, shape),
        view.known, true.contact,
    )  # fmt: skip


def _task(k: int):
    names = shapes.names("task")
    return shapes.shape(names[k % len(names)]).mesh


if __name__ == "__main__":
    show(answer(*sys.argv[1:]))
