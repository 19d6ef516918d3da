"""What a task is: trials of cases, each a rollout with decisions and an outcome. All values can be
pickled.

A task is one module with `TASK` and one line in `_TASKS`, or an entry point in `tactoscope.tasks`.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import field
from pathlib import Path
from typing import Protocol

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.entry_points import load_entry_points, load_reference
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.params import replace_value, setting
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import Pairing, TactileFrame, Truth

_LEAST_MM = 0.05  # a share that is named


@frozen
class Disturbance:
    """What goes wrong with a grasp besides the touch; directions are drawn for every trial."""

    slip: float = setting(
        0.0, "Slip", unit="mm", low=0.0, high=10.0, help="in the hand, between touch and action"
    )
    tilt: float = setting(
        0.0, "Tilt", unit="degrees", low=0.0, high=20.0, help="out of the fingers' plane"
    )
    alignment: float = setting(
        0.0,
        "Alignment error",
        unit="mm",
        low=0.0,
        high=10.0,
        help="of the source sensor, with a rotation of 2 degrees per mm",
    )


def parse_disturbance(assignments: Iterable[str]) -> Disturbance:
    """A disturbance from `name=value` each; raises SettingProblem."""
    disturbance = Disturbance()
    given = set[str]()
    for assignment in assignments:
        name, _, value = (part.strip() for part in assignment.partition("="))
        if name in given:
            raise SettingProblem(f"--disturb gives {name} more than once; give it once")
        given.add(name)
        try:
            disturbance = replace_value(disturbance, name, value)
        except SettingProblem as error:
            raise SettingProblem(f"--disturb {assignment}: {error}") from error
    return disturbance


@frozen
class TrialPlan:
    """One trial: the same seed, case and index give the same start, whatever the touch and the
    tolerance.
    """

    task: str  # a name of the catalogue, or a TOML file
    case: str
    index: int
    touches: tuple[str, ...]  # touch methods, "true" or "none"
    tolerances_mm: tuple[float, ...]
    seed: int
    vary: float = 0.0  # of sensor instances, as in `tactoscope simulate`
    attribute: bool = False
    record_frames: bool = False
    disturbance: Disturbance = field(default_factory=Disturbance)


@frozen
class StageShare:
    """Decrease of a decision's error when one more stage is replaced by ground truth, and the
    outcome from there.
    """

    stage: str
    title: str
    share_mm: float
    remaining_mm: float
    succeeds: bool  # the rollout, run again from the decision with the truth so far


@frozen
class Decision:
    """One decision of the controller against the truth."""

    tick: int  # of the rollout's tables
    error_mm: float  # the task's own measure of how far off the decision is
    estimate: Mapping[str, float] = field(default_factory=dict)
    truth: Mapping[str, float] = field(default_factory=dict)
    shares: tuple[StageShare, ...] = ()  # add up to `error_mm`; empty = not attributed


def describe_error(decision: Decision, title: str, *, succeeds: bool) -> str:
    """The error at a decision by its parts, and the first truth with which the rollout succeeds.

    `title` is what the task's error measures; `succeeds` whether the rollout does as it is.
    """
    text = f"{decision.error_mm:.1f} mm {title}"
    if succeeds:
        return f"{text}; it succeeds: there is no failure to attribute"
    text = f"fails by {text}"
    named = [
        f"{part.share_mm:.1f} the {part.title}"
        for part in sorted(decision.shares, key=lambda share: -share.share_mm)
        if abs(part.share_mm) >= _LEAST_MM
    ]
    if named:
        text += f"; of it {', '.join(named)}"
    flips = next((part for part in decision.shares if part.succeeds), None)
    if flips is not None:
        return f"{text}; with the true {flips.title.removeprefix('generated ')} it succeeds"
    return f"{text}; it fails with the truth as well" if decision.shares else text


@frozen
class Tick:
    """One control tick."""

    time_s: float
    world_from_object: Doubles  # (4, 4) mm
    world_from_hand: Doubles  # (4, 4) mm, as it is
    commanded: Doubles  # (4, 4) mm, the hand as commanded
    force_n: Doubles  # (3,) on the object, world axes
    # (4, 4) mm, other moving bodies by name
    world_from_bodies: Mapping[str, Doubles] = field(default_factory=dict)


@frozen
class Attempt:
    """What a robot did on one decision, and how it ended."""

    ticks: tuple[Tick, ...]
    succeeds: bool
    cause: str
    measures: Mapping[str, float]


@frozen
class RolloutSummary:
    """What a table and `--json` show of a rollout."""

    case: str
    trial: int
    touch: str
    tolerance_mm: float
    succeeds: bool
    cause: str  # one sentence
    measures: Mapping[str, float]
    decisions: tuple[Decision, ...]


@frozen
class Rollout(RolloutSummary):
    """One run of one trial with one touch and one tolerance."""

    ticks: tuple[Tick, ...] = ()
    # stream, frame, truth; the same index = one moment
    frames: tuple[tuple[str, TactileFrame, Truth | None], ...] = ()
    pairings: tuple[Pairing, ...] = ()
    mesh: Mesh | None = None

    @property
    def name(self) -> str:
        """Usable as the name of a file."""
        return f"{self.case}_{self.touch}_{self.tolerance_mm:g}mm_{self.trial:03d}"


class RunTrial(Protocol):
    """Runs one trial; `progress` receives what is done, and ends the trial by an exception."""

    def __call__(self, plan: TrialPlan, progress: Progress = SILENT) -> Iterable[Rollout]:
        """One rollout for each touch and tolerance, in this order."""
        ...


@frozen
class RecordedRollout:
    """A rollout as read from its recording."""

    path: Path
    plan: TrialPlan  # of this touch and tolerance alone
    summary: RolloutSummary
    time_s: Doubles  # (n,) of every tick
    world_from_object: Doubles  # (n, 4, 4) mm
    world_from_hand: Doubles  # (n, 4, 4) mm, as it is
    commanded: Doubles  # (n, 4, 4) mm, the hand as commanded
    force_n: Doubles  # (n, 3) on the object, world axes
    world_from_bodies: Mapping[str, Doubles]  # (n, 4, 4) mm, other moving bodies by name
    mesh: Mesh | None = None  # of the object

    @property
    def n_ticks(self) -> int:
        """Number of control ticks."""
        return len(self.time_s)

    def find_decision(self, tick: int) -> int:
        """Index of the decision that acts at a tick: the last one up to it; 0 before the first."""
        before = [k for k, decision in enumerate(self.summary.decisions) if decision.tick <= tick]
        return max(before, default=0)


@frozen
class SceneBody:
    """A rigid body as the 3D scene of a task shows it."""

    name: str  # for the legend, unique in its scene
    mesh: Mesh
    parent: str = "world"  # "world", "object", "hand", or a name of `Tick.world_from_bodies`
    parent_from_body: Doubles = field(default_factory=lambda: freeze(np.eye(4)))


@frozen
class TaskScene:
    """What surrounds the object of a rollout, and where a decision believes the object."""

    bodies: tuple[SceneBody, ...]  # the object is not among them
    # (4, 4) mm, hand_from_object as estimated
    hand_from_estimate: Callable[[Decision], Doubles] | None = None
    object_mesh: Mesh | None = None  # where the touched mesh is only a part of the object


@frozen
class ManipulationTask:
    """A closed-loop task."""

    name: str
    title: str
    source: str  # sensor that records
    target: str  # sensor that the controller is made for
    cases: tuple[str, ...]
    touches: tuple[str, ...]  # by default
    tolerances_mm: tuple[float, ...]  # by default; what is swept
    tolerance_title: str
    n_trials: int  # by default, as in the paper
    run: RunTrial  # one rollout for each touch and tolerance, in this order
    # of this task alone, besides "true", "none" and touch methods
    further_touches: tuple[str, ...] = ()
    holds_object: bool = False  # in a grasp, which can be disturbed
    error_title: str = "error"  # what a decision's `error_mm` measures
    # (case, touch) -> the paper's result
    published: Mapping[tuple[str, str], str] = field(default_factory=dict)
    # the name of a user's TOML file as a case; raises TouchError
    load_case: Callable[[Path], str] | None = None
    build_scene: Callable[[RecordedRollout], TaskScene] | None = None  # None = the object alone


_TASKS = {
    "insertion": "pipeline.lab.tasks.insertion:TASK",
    "stack": "pipeline.lab.tasks.stack:TASK",
    "marble": "pipeline.lab.tasks.marble:TASK",
}


def load_task(name: str) -> ManipulationTask:
    """The task of this name; raises SettingProblem."""
    added = {task.name: task for task in load_entry_points("tactoscope.tasks", ManipulationTask)}
    if name in added:
        return added[name]
    if name not in _TASKS:
        known = ", ".join(sorted({*_TASKS, *added}))
        raise SettingProblem(
            f"no task {name!r}; there are {known}, and TOML files of tools for insertion"
        )
    return load_reference(_TASKS[name])
