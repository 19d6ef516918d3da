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
from pipeline.calibration.ball_slopes import TRUSTED_RADIUS_SHARE
from pipeline.calibration.calibration_table import BallFit, Calibration, make_built_in
from pipeline.engine.digests import compute_digest
from pipeline.metrics.stage_metrics import iou
from pipeline.networks import network_factory, weights_registry
from pipeline.networks.weights import Weights
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import gel_network, photometric
from pipeline.stages.depth.ball_calibration import calibrate_sensor
from pipeline.stages.depth.gel_network import NetworkParams
from pipeline.training import gel_samples, recorded_touches
from pipeline.training.ball_depth import BallDepthTask
from pipeline.training.gel_samples import GelTrainingSample
from pipeline.training.recipe import Optimiser, Recipe, TrainingSettings, Validation
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap

MIN_PRESSES = 6  # presses: a third of fewer tells nothing
N_STEPS = 90
CALIBRATION_TABLE, SHIPPED_NETWORK, TRAINED_NETWORK = "look-up", "shipped network", "taught network"
_HELD = 3  # every third press
_BATCH, _RATE = 8, 5e-4
_SHARE = 0.7  # of what is taught: the rest are simulated touches
_TOOLS = 6  # simulated, held out
_FLATTEST = 0.05  # curvature over the ball's: flatter is told as that


@dataclass(frozen=True, slots=True, kw_only=True)
class InstancePresses:
    """Pictures of presses of one ball, and which of them are held out."""

    images: Sequence[Image]
    reference: Image
    sensor: SensorSpec
    diameter_mm: float
    full_calibration: Calibration  # of all presses: it knows their circles
    training_indices: tuple[int, ...]
    validation_indices: tuple[int, ...]

    def make_frame(self, index: int) -> TactileFrame:
        """One of them."""
        return TactileFrame(
            sensor=self.sensor.name, image=self.images[index], reference=self.reference, index=index
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class BallErrors:
    """How far off the ball something that reads presses is: a number for each press held out."""

    shape_rms_mm: Doubles  # rms inside the contact's circle, its own height given
    diameter_error: Doubles  # of the sphere nearest there, less the ball's, over the ball's
    contact_error: Doubles  # 1 - IoU with the circle


def split_presses(
    images: Sequence[Image], reference: Image, sensor: SensorSpec, diameter_mm: float, whole: Calibration, seed: int
) -> InstancePresses:
    """The presses in which the ball was found, a third of them held out; raises CalibrationError for too few."""
    used = [press.index for press in whole.presses if press.used]
    if len(used) < MIN_PRESSES:
        raise CalibrationError(
            f"the ball was found in {len(used)} presses, and a network is taught on {MIN_PRESSES} at least, a third of them "
            "held out; press more often, all over the gel"
        )
    order = np.random.default_rng(seed).permutation(used).tolist()
    n_held = math.ceil(len(used) / _HELD)
    return InstancePresses(
        images=images, reference=reference, sensor=sensor, diameter_mm=diameter_mm, full_calibration=whole,
        training_indices=tuple(sorted(order[n_held:])), validation_indices=tuple(sorted(order[:n_held])),
    )  # fmt: skip


def fit_training_calibration(presses: InstancePresses, *, seed: int, progress: Progress = SILENT) -> Calibration:
    """The look-up of those presses that are not held out."""
    return calibrate_sensor(
        [presses.images[i] for i in presses.training_indices], presses.reference, presses.sensor, presses.diameter_mm,
        pixel_mm=presses.full_calibration.pixel_mm, progress=progress, seed=seed,
    )  # fmt: skip


def load_shipped_network() -> Weights:
    """The network that comes along; raises ModelMissing where it does not."""
    found = weights_registry.load_shipped("gel_depth")
    if not isinstance(found, Weights):
        raise ModelMissing(found.why)
    return found


def make_recipe(
    presses: InstancePresses, look_up: Calibration, folder: Path, *, seed: int, progress: Progress = SILENT
) -> Recipe:
    """What is taught, and how; `folder` keeps simulated pictures."""
    begin = load_shipped_network()
    fits = {fit.index: fit for fit in presses.full_calibration.presses}
    taught: dict[int, GelTrainingSample] = {}
    for done, index in enumerate((*presses.training_indices, *presses.validation_indices)):
        progress.step(
            done / len(fits),
            f"reading press {done + 1} of {len(presses.training_indices) + len(presses.validation_indices)}",
        )
        taught[index] = _make_training_sample(presses, look_up, fits[index])
    learned, held = (
        tuple(taught[i] for i in which) for which in (presses.training_indices, presses.validation_indices)
    )
    return Recipe(
        name="own_unit", task="ball_depth",
        settings=BallDepthTask(
            content_digest=compute_digest((learned, held, begin.content_digest)), folder=str(folder), press_share=_SHARE, training_samples=learned, validation_samples=held
        ),
        network={"kind": begin.kind, **begin.config, "calibrated": True},
        training=TrainingSettings(seed=seed, batch=_BATCH, steps=N_STEPS, initial_weights=str(weights_registry.WEIGHTS_FOLDER / "gel_depth.safetensors")),
        optimiser=Optimiser(learning_rate=_RATE, warm_up_steps=10, ema_decay=0.95),
        validation=Validation(n_evaluations=1, n_examples=min(_TOOLS, len(held))),
    )  # fmt: skip


def _make_training_sample(presses: InstancePresses, look_up: Calibration, fit: BallFit) -> GelTrainingSample:
    frame, wide = presses.make_frame(fit.index), gel_network.match_pixel_size(presses.sensor, look_up)
    seen = photometric.estimate_depth(frame, presses.sensor, look_up, photometric.DepthParams()).indentation_mm
    surface, contact = recorded_touches.simulate_ball_press(wide, seen, 0.5 * presses.diameter_mm, fit)
    return gel_samples.make_gel_sample(frame, presses.sensor, surface, contact, look_up)


def evaluate_on_validation(
    presses: InstancePresses, look_up: Calibration, trained: Weights, progress: Progress = SILENT
) -> dict[str, BallErrors]:
    """What three ways make of the presses that were held out, by name."""
    plain = replace(make_built_in(presses.sensor), pixel_mm=look_up.pixel_mm)
    fits = {fit.index: fit for fit in presses.full_calibration.presses}
    found: dict[str, list[tuple[float, float, float]]] = {
        CALIBRATION_TABLE: [],
        SHIPPED_NETWORK: [],
        TRAINED_NETWORK: [],
    }
    for done, index in enumerate(presses.validation_indices):
        progress.step(
            done / len(presses.validation_indices),
            f"judging press {done + 1} of {len(presses.validation_indices)} held out",
        )
        frame, sensor = presses.make_frame(index), presses.sensor
        read = {
            CALIBRATION_TABLE: photometric.estimate_depth(frame, sensor, look_up, photometric.DepthParams()),
            SHIPPED_NETWORK: _by_network(frame, sensor, plain, load_shipped_network()),
            TRAINED_NETWORK: _by_network(frame, sensor, look_up, trained),
        }
        for name, depth in read.items():
            found[name].append(measure_ball_error(depth, fits[index], 0.5 * presses.diameter_mm, look_up.pixel_mm))
    tables = {name: np.array(rows, np.float64).T for name, rows in found.items()}
    return {
        name: BallErrors(shape_rms_mm=of[0], diameter_error=of[1], contact_error=of[2]) for name, of in tables.items()
    }


def _by_network(frame: TactileFrame, sensor: SensorSpec, look_up: Calibration, weights: Weights) -> DepthMap:
    network: Any = network_factory.load_predictor(weights)
    return gel_network.estimate_depth(frame, sensor, look_up, network, NetworkParams())


def measure_ball_error(depth: DepthMap, fit: BallFit, ball_mm: float, pixel_mm: float) -> tuple[float, float, float]:
    """One press as `Off` has it; `ball_mm` is the ball's radius."""
    rows, cols = depth.contact.shape
    away_mm = pixel_mm * np.hypot(np.arange(cols)[None, :] - fit.x_px, np.arange(rows)[:, None] - fit.y_px)
    inside = away_mm < TRUSTED_RADIUS_SHARE * fit.radius_px * pixel_mm
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


def is_trained_best(off: dict[str, BallErrors]) -> bool:
    """Whether the taught network is nearer to the ball than both others: in the mean, and in most presses."""
    taught, others = (
        off[TRAINED_NETWORK].shape_rms_mm,
        [off[name].shape_rms_mm for name in (CALIBRATION_TABLE, SHIPPED_NETWORK)],
    )
    return all(taught.mean() < other.mean() and np.mean(taught < other) > 0.5 for other in others)
