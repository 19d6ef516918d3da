"""The touches that methods are scored on: presses that nothing was taught on, simulated once and kept."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.base.files import set_aside
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.engine import disk_store
from pipeline.engine.digests import compute_digest
from pipeline.evaluation.published_results import Split
from pipeline.simulation import datasets, recorder
from pipeline.simulation.datasets import SimulationPlan

SENSORS = ("gelslim", "soft_bubble", "digit")
_TARGETS = SENSORS[:2]
MAX_GRASPS = 1000
TouchSet = Split | Literal["usual"]  # "usual": touches of training objects, which the mean touch is taken of
_SEEDS: dict[str, int] = {"unseen_grasps": 40_001, "unseen_tools": 40_002, "usual": 40_003}


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutOptions:
    """Which touches, and by which units of the sensors."""

    grasps: int = 5  # of each object
    sensor_variation: float = (
        1.0  # how far a source differs from the described unit, 1 = as those of a lab; a target never does
    )
    folder: Path | None = None  # where they are kept; None = the user's cache


@dataclass(frozen=True, slots=True, kw_only=True)
class PressRecordings:
    """The same presses of one object as felt by other units and by the described ones."""

    object_name: str
    source: Path
    target: Path


def select_sensors(source: str, target: str) -> tuple[str, ...]:
    """Which sensors are to feel the touches of a direction: `SENSORS`, or those two beside the usual targets."""
    return SENSORS if {source, target} <= set(SENSORS) else tuple(dict.fromkeys((*_TARGETS, source, target)))


def load_or_simulate(
    of: TouchSet, held_out: HeldOutOptions, progress: Progress = SILENT, sensors: tuple[str, ...] = SENSORS
) -> tuple[PressRecordings, ...]:
    """Recordings of every object, felt by all `sensors` at once; what is not there yet is simulated.

    A source may be any unit; whoever generates a touch does so for the target that is described, so that it is the
    described one that recorded what is compared with. Raises SettingProblem for a number of grasps that makes no sense,
    FileProblem where nothing can be written.
    """
    if not 1 <= held_out.grasps <= MAX_GRASPS:
        raise SettingProblem(f"--grasps must lie within 1 and {MAX_GRASPS}, got {held_out.grasps}")
    like = SimulationPlan(
        sensors=sensors, object_source="", n_poses=held_out.grasps, seed=_SEEDS[of], vary=held_out.sensor_variation
    )
    plans = datasets.make_plans(("unseen" if of == "unseen_tools" else "training",), like)
    made: list[PressRecordings] = []
    for index, plan in enumerate(plans):
        part = SubProgress(progress, index / len(plans), 1.0 / len(plans), f"simulating {plan.object_name}")
        paths = [_recorded(of, unit, held_out.folder, part) for unit in (plan, replace(plan, vary=0.0))]
        made.append(PressRecordings(object_name=plan.object_name, source=paths[0], target=paths[1]))
    return tuple(made)


def _recorded(of: TouchSet, plan: SimulationPlan, folder: Path | None, progress: Progress) -> Path:
    # What would give other readings has another name, so that old recordings are neither taken nor in the way.
    name = f"{of}_{plan.object_name}_{compute_digest(datasets.describe_plan(plan))[:8]}.h5"
    path = (folder or disk_store.cache_folder() / "held_out") / name
    try:
        done = recorder.count_finished_moments(plan, path)
    except FileProblem:  # by its name it was one of these recordings
        done, _ = 0, set_aside(path)
    if done < plan.n_poses:
        recorder.record_plan(plan, path, progress=progress)
    return path
