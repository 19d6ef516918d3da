"""Run a recorded rollout again from its plan: to attribute the error of its decisions, and to
replay it, and
the repro bundle of a rollout: a folder with its recording and its case.

bundle.json      version, a note, the command that replays it
rollout.h5       the recording with the plan
NAME.toml, mesh  a case of one's own
"""

import math
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline import __version__
from pipeline.core.errors import FileProblem, NotConverged
from pipeline.core.files import read_json, read_toml, write_folder, write_json
from pipeline.core.frozen import frozen
from pipeline.core.progress import SILENT, Progress
from pipeline.lab.tasks.rollout_file import CASE_SUFFIX, read_rollout
from pipeline.lab.tasks.task import Decision, RecordedRollout, Rollout, load_task

# of poses and forces: rounding of another processor
SAME_MM = 1e-3
SAME_N = 1e-2


@frozen
class RolloutAgreement:
    """How well a rollout that was run again agrees with its recording."""

    same_outcome: bool
    pose_mm: float  # largest difference of an object position; inf = another number of ticks
    force_n: float  # largest difference of a contact force

    @property
    def is_same(self) -> bool:
        """Whether all is the same but for rounding."""
        return self.same_outcome and self.pose_mm <= SAME_MM and self.force_n <= SAME_N


def run_again(
    rollout: RecordedRollout, progress: Progress = SILENT, *, attribute: bool = False
) -> Rollout:
    """The rollout of the same plan, with its errors attributed if asked; raises TouchError."""
    plan = replace(rollout.plan, attribute=attribute, record_frames=True)
    (again,) = load_task(plan.task).run(plan, progress)
    return again


def compare_rollouts(recorded: RecordedRollout, again: Rollout) -> RolloutAgreement:
    """Compare a rollout with its recording."""
    if len(again.ticks) != recorded.n_ticks:
        return RolloutAgreement(same_outcome=False, pose_mm=math.inf, force_n=math.inf)
    poses = np.array([tick.world_from_object[:3, 3] for tick in again.ticks])
    forces = np.array([tick.force_n for tick in again.ticks])
    return RolloutAgreement(
        same_outcome=again.succeeds == recorded.summary.succeeds,
        pose_mm=float(np.abs(poses - recorded.world_from_object[:, :3, 3]).max()),
        force_n=float(np.abs(forces - recorded.force_n).max()),
    )


def attribute_rollout(
    rollout: RecordedRollout, progress: Progress = SILENT
) -> tuple[Decision, ...]:
    """The decisions with their errors attributed: as recorded, or by running the rollout again.

    Raises NotConverged where the rollout that was run again is another one than the recorded.
    """
    if any(decision.shares for decision in rollout.summary.decisions):
        return rollout.summary.decisions
    again = run_again(rollout, progress, attribute=True)
    if not compare_rollouts(rollout, again).is_same:
        raise NotConverged(
            "run again, this rollout ends otherwise than recorded: it is of another version of "
            "this program; "
            "run the task again with --attribute"
        )
    return again.decisions


_VERSION = 1
_VERSION_KEY = "tactoscope rollout bundle"
_ROLLOUT = "rollout.h5"


@frozen
class RolloutReplay:
    """Result of a replayed rollout."""

    note: str
    cause: str  # how it ended when it was run again
    agreement: RolloutAgreement


def write_rollout_bundle(path: Path, folder: Path, *, note: str = "") -> None:
    """Write the repro bundle of a recorded rollout into a new folder; raises TouchError."""
    if folder.exists():
        raise FileProblem(
            "something of this name is there already and is kept; choose another", folder
        )
    rollout = read_rollout(path)

    def fill(part: Path) -> None:
        shutil.copyfile(path, part / _ROLLOUT)
        if rollout.plan.case.endswith(CASE_SUFFIX):
            copy_case(Path(rollout.plan.case), part)
        command = shlex.join(["tactoscope", "replay", str(folder.absolute())])
        write_json(
            part / "bundle.json",
            {
                _VERSION_KEY: _VERSION,
                "made with": __version__,
                "note": note,
                "of": path.name,
                "command": command,
            },
            "the repro bundle",
        )

    write_folder(folder, fill)


def copy_case(case: Path, folder: Path) -> None:
    """Copy a case's TOML file and the mesh next to it into a folder; raises FileProblem."""
    mesh = str(read_toml(case, "the task").get("mesh", ""))
    if mesh != Path(mesh).name:
        raise FileProblem("the mesh of a recorded case must lie next to its TOML file", case)
    folder.mkdir(parents=True, exist_ok=True)
    for name in (case.name, mesh):
        if (case.parent / name).resolve() != (folder / name).resolve():
            shutil.copyfile(case.parent / name, folder / name)


def is_rollout_bundle(folder: Path) -> bool:
    """Whether a folder is the repro bundle of a rollout.

    Raises FileProblem where it is no bundle at all.
    """
    head = read_json(folder / "bundle.json", "the repro bundle")
    return isinstance(head, dict) and _VERSION_KEY in head


def replay_rollout(folder: Path, progress: Progress = SILENT) -> RolloutReplay:
    """Run the rollout of a bundle again and compare it with its recording; raises TouchError."""
    head = read_json(folder / "bundle.json", "the repro bundle")
    version = head.get(_VERSION_KEY) if isinstance(head, dict) else None
    if version != _VERSION:
        raise FileProblem(
            f"the repro bundle has version {version!r}, this program reads {_VERSION}", folder
        )
    rollout = read_rollout(folder / _ROLLOUT)
    again = run_again(rollout, progress)
    note = head.get("note", "") if isinstance(head, dict) else ""
    return RolloutReplay(
        note=str(note), cause=again.cause, agreement=compare_rollouts(rollout, again)
    )
