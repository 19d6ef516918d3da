"""A network for one unit: the shipped one, taught on presses of a ball what the unit's look-up leaves.

A third of the presses is held out, of the look-up that the network learns beside as well. Inside its contact the gel is
the ball, whose radius is known, so that all that reads them can be judged by how far off the ball they are there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.arrays import Doubles, Image
from pipeline.base.errors import CalibrationError, ModelMissing
from pipeline.base.progress import SILENT, Progress
from pipeline.calibration.ball_slopes import TRUSTED_SHARE
from pipeline.calibration.lookup import BallFit, Calibration, built_in
from pipeline.engine.digests import digest
from pipeline.evaluation.metrics import iou
from pipeline.networks import building, shelf
from pipeline.networks.weights import Weights
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import gel_network, stage
from pipeline.stages.depth.ball_calibration import calibrated
from pipeline.stages.depth.gel_network import NetworkParams
from pipeline.training import gel_readings, own
from pipeline.training.ball_depth import BallDepth
from pipeline.training.gel_readings import Taught
from pipeline.training.recipe import Optimiser, Pace, Recipe, Validation
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap

FEWEST = 6  # presses: a third of fewer tells nothing
STEPS = 90
LOOK_UP, SHIPPED, TAUGHT = "look-up", "shipped network", "taught network"
_HELD = 3  # every third press
_BATCH, _RATE = 8, 5e-4
_SHARE = 0.7  # of what is taught: the rest are simulated touches
_TOOLS = 6  # simulated, held out
_FLATTEST = 0.05  # curvature over the ball's: flatter is told as that


@dataclass(frozen=True, slots=True, kw_only=True)
class Presses:
    """Pictures of presses of one ball, and which of them are held out."""

    images: Sequence[Image]
    reference: Image
    sensor: SensorSpec
    diameter_mm: float
    whole: Calibration  # of all presses: it knows their circles
    learned: tuple[int, ...]
    held: tuple[int, ...]

    def frame(self, index: int) -> TactileFrame:
        """One of them."""
        return TactileFrame(
            sensor=self.sensor.name, image=self.images[index], reference=self.reference, index=index
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Off:
    """How far off the ball something that reads presses is: a number for each press held out."""

    ball_mm: Doubles  # rms inside the contact's circle, its own height given
    diameter: Doubles  # of the sphere nearest there, less the ball's, over the ball's
    contact: Doubles  # 1 - IoU with the circle


def parted(
    images: Sequence[Image], reference: Image, sensor: SensorSpec, diameter_mm: float, whole: Calibration, seed: int
) -> Presses:
    """The presses in which the ball was found, a third of them held out; raises CalibrationError for too few."""
    used = [press.index for press in whole.presses if press.used]
    if len(used) < FEWEST:
        raise CalibrationError(
            f"the ball was found in {len(used)} presses, and a network is taught on {FEWEST} at least, a third of them "
            "held out; press more often, all over the gel"
        )
    order = np.random.default_rng(seed).permutation(used).tolist()
    n_held = math.ceil(len(used) / _HELD)
    return Presses(
        images=images, reference=reference, sensor=sensor, diameter_mm=diameter_mm, whole=whole,
        learned=tuple(sorted(order[n_held:])), held=tuple(sorted(order[:n_held])),
    )  # fmt: skip


def look_up_of(presses: Presses, *, seed: int, progress: Progress = SILENT) -> Calibration:
    """The look-up of those presses that are not held out."""
    return calibrated(
        [presses.images[i] for i in presses.learned], presses.reference, presses.sensor, presses.diameter_mm,
        pixel_mm=presses.whole.pixel_mm, progress=progress, seed=seed,
    )  # fmt: skip


def shipped() -> Weights:
    """The network that comes along; raises ModelMissing where it does not."""
    found = shelf.shipped("gel_depth")
    if not isinstance(found, Weights):
        raise ModelMissing(found.why)
    return found


def recipe(presses: Presses, look_up: Calibration, folder: Path, *, seed: int, progress: Progress = SILENT) -> Recipe:
    """What is taught, and how; `folder` keeps simulated pictures."""
    begin = shipped()
    fits = {fit.index: fit for fit in presses.whole.presses}
    taught: dict[int, Taught] = {}
    for done, index in enumerate((*presses.learned, *presses.held)):
        progress.step(done / len(fits), f"reading press {done + 1} of {len(presses.learned) + len(presses.held)}")
        taught[index] = _taught(presses, look_up, fits[index])
    learned, held = (tuple(taught[i] for i in which) for which in (presses.learned, presses.held))
    return Recipe(
        name="own_unit", task="ball_depth",
        settings=BallDepth(
            content=digest((learned, held, begin.content)), folder=str(folder), share=_SHARE, learned=learned, held=held
        ),
        network={"kind": begin.kind, **begin.config, "calibrated": True},
        pace=Pace(seed=seed, batch=_BATCH, steps=STEPS, begin=str(shelf.FOLDER / "gel_depth.safetensors")),
        optimiser=Optimiser(learning_rate=_RATE, warm_up=10, average=0.95),
        validation=Validation(times=1, examples=min(_TOOLS, len(held))),
    )  # fmt: skip


def _taught(presses: Presses, look_up: Calibration, fit: BallFit) -> Taught:
    frame, wide = presses.frame(fit.index), gel_network.as_wide(presses.sensor, look_up)
    seen = stage.depth(frame, presses.sensor, look_up, stage.DepthParams()).indentation_mm
    surface, contact = own.ball_pressed(wide, seen, 0.5 * presses.diameter_mm, fit)
    return gel_readings.taught(frame, presses.sensor, surface, contact, look_up)


def judged(presses: Presses, look_up: Calibration, taught: Weights, progress: Progress = SILENT) -> dict[str, Off]:
    """What three ways make of the presses that were held out, by name."""
    plain = replace(built_in(presses.sensor), pixel_mm=look_up.pixel_mm)
    fits = {fit.index: fit for fit in presses.whole.presses}
    found: dict[str, list[tuple[float, float, float]]] = {LOOK_UP: [], SHIPPED: [], TAUGHT: []}
    for done, index in enumerate(presses.held):
        progress.step(done / len(presses.held), f"judging press {done + 1} of {len(presses.held)} held out")
        frame, sensor = presses.frame(index), presses.sensor
        read = {
            LOOK_UP: stage.depth(frame, sensor, look_up, stage.DepthParams()),
            SHIPPED: _by_network(frame, sensor, plain, shipped()),
            TAUGHT: _by_network(frame, sensor, look_up, taught),
        }
        for name, depth in read.items():
            found[name].append(off_ball(depth, fits[index], 0.5 * presses.diameter_mm, look_up.pixel_mm))
    tables = {name: np.array(rows, np.float64).T for name, rows in found.items()}
    return {name: Off(ball_mm=of[0], diameter=of[1], contact=of[2]) for name, of in tables.items()}


def _by_network(frame: TactileFrame, sensor: SensorSpec, look_up: Calibration, weights: Weights) -> DepthMap:
    network: Any = building.ready(weights)
    return gel_network.depth(frame, sensor, look_up, network, NetworkParams())


def off_ball(depth: DepthMap, fit: BallFit, ball_mm: float, pixel_mm: float) -> tuple[float, float, float]:
    """One press as `Off` has it; `ball_mm` is the ball's radius."""
    rows, cols = depth.contact.shape
    away_mm = pixel_mm * np.hypot(np.arange(cols)[None, :] - fit.x_px, np.arange(rows)[:, None] - fit.y_px)
    inside = away_mm < TRUSTED_SHARE * fit.radius_px * pixel_mm
    ball = np.sqrt(np.maximum(ball_mm**2 - away_mm[inside] ** 2, 0.0))
    seen = depth.indentation_mm[inside].astype(np.float64)
    ball, seen = ball - ball.mean(), seen - seen.mean()
    curved = float(seen @ ball) / max(float(ball @ ball), 1e-12)  # over the ball's own
    circle = away_mm < fit.radius_px * pixel_mm
    return (
        float(np.sqrt(np.mean((seen - ball) ** 2))),
        1.0 / max(curved, _FLATTEST) - 1.0,
        1.0 - iou(depth.contact, circle),
    )


def wins(off: dict[str, Off]) -> bool:
    """Whether the taught network is nearer to the ball than both others: in the mean, and in most presses."""
    taught, others = off[TAUGHT].ball_mm, [off[name].ball_mm for name in (LOOK_UP, SHIPPED)]
    return all(taught.mean() < other.mean() and np.mean(taught < other) > 0.5 for other in others)
