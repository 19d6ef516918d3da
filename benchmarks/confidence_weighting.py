"""How many times as far off as it says does a network have to be taken for, so that it falls back where it should?

    python benchmarks/confidence_weighting.py [t2t | t2d2] [SOURCE:TARGET] [WEIGHTS.safetensors] [TOUCHES]

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
from pipeline.evaluation.paper_tables import parse_direction
from pipeline.networks.network_factory import load_network
from pipeline.networks.weights import load_weights
from pipeline.physics import bubble_camera, optics
from pipeline.racing.results import BenchmarkResult
from pipeline.racing.text_report import print_result
from pipeline.sensors import alignment
from pipeline.simulation import poses, shapes
from pipeline.simulation.press import simulate_press
from pipeline.simulation.variation import vary_sensor
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.target_depth.surface_projection import SurfaceProjectionParams, project_cloud
from pipeline.stages.touch import physical_render, t2d2, t2t
from pipeline.stages.touch.confidence_weighting import ErrorCalibration, express_as_correction, shrink_to_prior
from pipeline.stages.touch.residual_diffusion import DiffusionParams, ResidualSample, sample_residual
from pipeline.stages.touch.residual_render import resample_to_grid
from pipeline.training.target_touches import sample_object_mesh
from pipeline.values.frames import TactileFrame

TOUCHES, SEED, UNITS = 60, 2929, 7000
INFLATIONS = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0)  # times an error of a third of the network's unit
POWERS = (1.0, 1.5, 2.0, 2.5)
HARM = 1.0  # an error where physics had less counts so much more: caution is there to do no harm
REGIONS = ("in contact", "over all", "where the source felt", "beyond")
VISIBLE, OUTSIDE = 2, 3
GROUPS = ("learned", "task")
SENSORS = ("soft_bubble", "gelslim", "gelsight_mini", "digit")  # each of them another unit


@dataclass(frozen=True, slots=True)
class _Asked:
    """One touch: what the network corrects and says of its error, what it begins with, the truth, where it was felt."""

    found: ResidualSample
    unit_mm: float
    begun_mm: np.ndarray
    truth_mm: np.ndarray
    known: np.ndarray
    contact: np.ndarray

    def compute_errors(self, visible: float, beyond: float, power: float) -> np.ndarray:
        """In contact, over all, where the source felt, beyond; mm."""
        larger = 3.0 ** (power - 1.0)
        trusted = ErrorCalibration(
            factor_in_view=visible * larger, factor_outside=beyond * larger, exponent=power, unit_mm=self.unit_mm
        )
        return self._off(shrink_to_prior(self.found, self.known, 1.0, trusted).final.residual_mm)

    def compute_physics_errors(self) -> np.ndarray:
        """The same of what it begins with."""
        return self._off(np.zeros_like(self.begun_mm))

    def _off(self, kept: np.ndarray) -> np.ndarray:
        gap = np.abs(self.begun_mm + kept - self.truth_mm)
        known = resample_to_grid(self.known, gap.shape) > 0.5
        regions = (resample_to_grid(self.contact, gap.shape) > 0.5, np.ones_like(known), known, ~known)
        return np.array([float(gap[region].mean()) if region.any() else np.nan for region in regions])


def measure(
    method: str = "t2t", way: str = "gelslim:soft_bubble", file: str = "", touches: str = str(TOUCHES)
) -> BenchmarkResult:
    source, target = (_described(name) for name in parse_direction(way))
    module = t2t if method == "t2t" else t2d2
    net = load_network(load_weights(Path(file)) if file else module.select_weights(source, target, None))
    notes, every = [f"errors in mm {', '.join(REGIONS)}"], []
    for group in GROUPS:
        kept = [f for k in range(int(touches)) if (f := _asked(net, method, source, target, group, k)) is not None]
        what = "task objects" if group == "task" else "training objects held anew, random bodies"
        notes.append(f"{what}, {len(kept)} touches: physics {_said([one.compute_physics_errors() for one in kept])}, network "
                     f"{_said([one.compute_errors(0.0, 0.0, 1.0) for one in kept])}")  # fmt: skip
        every.append(kept)
    found = sorted((_chosen(every, power) for power in POWERS), key=lambda one: one[0])
    for cost, power, felt, beyond in found:
        told = "; ".join(_said([one.off(felt, beyond, power) for one in kept]) for kept in every)
        larger = 3.0 ** (power - 1.0)
        notes.append(f"power {power:g}: doubt {felt * larger:.3g}, beyond {beyond * larger:.3g}: {told} ({cost:.4g})")
    return BenchmarkResult(title=f"caution of {method}, {way}", unit="mm", rows=(), notes=tuple(notes))


def _chosen(groups, power: float) -> tuple[float, float, float, float]:
    """(cost over all, power, doubt where it felt, doubt beyond), each doubt that which costs least there."""
    table = {d: [np.array([one.off(d, d, power) for one in kept]) for kept in groups] for d in INFLATIONS}
    physics = [np.array([one.by_physics() for one in kept]) for kept in groups]

    def cost(off, region: int) -> float:
        each = [
            o[:, region] + HARM * np.maximum(o[:, region] - p[:, region], 0.0)
            for o, p in zip(off, physics, strict=True)
        ]
        return float(np.mean([np.nanmean(one) if np.isfinite(one).any() else 0.0 for one in each]))

    felt, beyond = (min(table, key=lambda d, r=region: cost(table[d], r)) for region in (VISIBLE, OUTSIDE))
    both = [np.array([one.off(felt, beyond, power) for one in kept]) for kept in groups]
    return cost(both, 1), power, felt, beyond


def _said(off) -> str:
    return "/".join(f"{np.nanmean(region):.3g}" if np.isfinite(region).any() else "-" for region in np.array(off).T)


def _asked(net, method: str, source, target, group: str, k: int) -> _Asked | None:
    rng = np.random.default_rng([SEED, k])
    thing = sample_object_mesh("learned", rng, k) if group == "learned" else _task(k)
    pose = poses.sample_press_pose(thing, rng)
    unit = vary_sensor(source, UNITS + 10 * k + SENSORS.index(source.name))
    reading, true = simulate_press(thing, pose, unit, seed=2 * k), simulate_press(thing, pose, target, seed=None).truth
    if not reading.truth.contact.any() or not true.contact.any():
        return None
    untouched = unit.rest_depth_mm if unit.kind == "bubble" else None
    reference = (
        optics.render_reference(unit)
        if untouched is None
        else bubble_camera.simulate_depth_frame(unit, untouched, 2 * k + 1)
    )
    frame, stand = TactileFrame(sensor=source.name, image=reading.image, reference=reference), alignment.resolve_alignment(
        source, target
    )  # fmt: skip
    view = project_cloud(
        back_project_depth(_read(frame, source), stand, BackProjectionParams()), target, SurfaceProjectionParams()
    )
    if not view.contact.any():
        return None
    physical = physical_render.render_touch(view, target, physical_render.PhysicalRenderParams()).membrane
    if method == "t2t":
        found = express_as_correction(
            sample_residual(net, t2t.build_condition(frame, source, stand, target), DiffusionParams()), physical
        )
    else:
        found = sample_residual(net, t2d2.build_condition(view, physical, target), DiffusionParams())
    shape = found.expected_error_mm.shape
    return _Asked(
        found, float(net.unit_mm), resample_to_grid(physical.indentation_mm, shape), resample_to_grid(true.indentation_mm, shape),
        view.in_view, true.contact,
    )  # fmt: skip


def _task(k: int):
    names = shapes.list_shapes("task")
    return shapes.make_shape(names[k % len(names)]).mesh


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:]))
