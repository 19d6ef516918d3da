"""How many times as far off as it says does a network have to be taken for, so that it falls back where it should?

    python benchmarks/caution.py [t2t | t2d2] [TARGET] [WEIGHTS.safetensors] [FOLDER]

Touches of training objects and random bodies that the weights were not learned from (numbers behind those of the
recipe), in one step. The third of them on which the physical render is nearest to the truth are like objects of which
the network knows nothing: there falling back must cost nothing. The weights of T2T carry the least doubt for which that
third is about as good as physics, where the source felt and beyond (`doubt`, `doubt_beyond`); a doubt of 0 takes all
that the network says. Nothing is asked of the held-out splits.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from pipeline.engine.graph import Skipped
from pipeline.networks.building import network
from pipeline.networks.weights import load
from pipeline.physics import optics
from pipeline.racing.races import Answer
from pipeline.racing.report import show
from pipeline.sensors import alignment
from pipeline.sensors.spec import sensor
from pipeline.stages.generate import picture_to_touch, view_to_touch
from pipeline.stages.generate.caution import taken
from pipeline.stages.generate.corrected import on_grid
from pipeline.stages.generate.diffusion import DiffusionParams, sampled
from pipeline.stages.generate.residual_input import of_view
from pipeline.stages.generate.stage import GenerateParams
from pipeline.training.own_touches import own_touch
from pipeline.training.touch_pairs import pair, units
from pipeline.values.frames import TactileFrame

TOUCHES, FIRST = 70, 1700  # numbers from this one on: no recipe of weights that come along drew them
DOUBTS = (0.0, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)


@dataclass(frozen=True, slots=True)
class _Asked:
    """One touch: what the network corrects and says of its error, what it begins with, the truth, where it was felt."""

    correction_mm: np.ndarray
    spread_mm: np.ndarray
    begun_mm: np.ndarray
    truth_mm: np.ndarray
    known: np.ndarray

    def off(self, doubt: float, where: np.ndarray) -> float:
        share = taken(self.correction_mm, doubt * self.spread_mm)
        gap = np.abs(self.begun_mm + share * self.correction_mm - self.truth_mm)
        return float(gap[where].mean()) if where.any() else np.nan


def answer(method: str = "t2t", target: str = "soft_bubble", file: str = "", folder: str = "") -> Answer:
    spec = sensor(target)
    module, source = (picture_to_touch, "gelslim") if method == "t2t" else (view_to_touch, "digit")
    weights = load(Path(file)) if file else module.weights(sensor(source), spec, None)
    net = network(weights)
    found = [_of_pair(net, k, folder) if method == "t2t" else _of_own(net, target, k, folder)
             for k in range(FIRST, FIRST + TOUCHES)]  # fmt: skip
    kept = sorted((f for f in found if f is not None), key=lambda f: np.abs(f.begun_mm - f.truth_mm).mean())
    third = len(kept) // 3
    notes = [f"{len(kept)} touches; errors in mm where the source felt / beyond it, physics first"]
    for name, part in (("physics is nearest", kept[:third]), ("all others", kept[third:])):
        told = ["physics " + _said(part, 1e6), *(f"doubt {d:g} {_said(part, d)}" for d in DOUBTS)]
        notes.append(f"{name}: " + "; ".join(told))
    return Answer(title=f"caution of {method} to {spec.title}", unit="mm", rows=(), notes=tuple(notes))


def _said(part, doubt: float) -> str:
    within, beyond = (np.nanmean([f.off(doubt, f.known == inside) for f in part]) for inside in (True, False))
    return f"{within:.3g}/{beyond:.3g}"


def _of_pair(net, index: int, folder: str) -> _Asked | None:
    touch = pair("learned", 1, index, folder)
    if touch is None:
        return None
    gel, bubble = units(float(touch.deeper_mm[0]))
    still, between = optics.untouched(gel), alignment.between(gel, bubble)
    image = np.clip(np.rint(still + touch.change_grey), 0, 255).astype(np.uint8)
    frame = TactileFrame(sensor=gel.name, image=image, reference=still)
    physical = picture_to_touch.by_physics(frame, gel, None, between, bubble, GenerateParams())
    physical = physical.output if isinstance(physical, Skipped) else physical
    found = sampled(net, picture_to_touch.condition(frame, gel, between, bubble), DiffusionParams())
    begun = on_grid(physical.membrane.indentation_mm, found.spread_mm.shape)
    return _Asked(found.last.residual_mm - begun, found.spread_mm, begun, touch.bubble_mm, physical.known)


def _of_own(net, target: str, index: int, folder: str) -> _Asked | None:
    touch = own_touch(target, "learned", 1, index, folder)
    if touch is None:
        return None
    shown = of_view(
        sensor(target).kind, touch.told_mm, touch.felt, touch.known, touch.physical_mm, touch.physical_contact
    )
    found = sampled(net, shown, DiffusionParams())
    return _Asked(found.last.residual_mm, found.spread_mm, touch.physical_mm, touch.truth_mm, touch.known)


if __name__ == "__main__":
    show(answer(*sys.argv[1:]))
