"""Repro bundle of a rollout: a folder with its recording and its case, which runs again from the
plan.

bundle.json      version, a note, the command that replays it
rollout.h5       the recording with the plan
NAME.toml, mesh  a case of one's own
"""

import shlex
import shutil
from dataclasses import dataclass
from pathlib import Path

from pipeline import __version__
from pipeline.core.errors import FileProblem
from pipeline.core.files import read_json, read_toml, write_folder, write_json
from pipeline.core.progress import SILENT, Progress
from pipeline.lab.tasks.rerun import RolloutAgreement, compare_rollouts, run_again
from pipeline.lab.tasks.rollout_file import CASE_SUFFIX, read_rollout

_VERSION = 1
_VERSION_KEY = "tactoscope rollout bundle"
_ROLLOUT = "rollout.h5"


@dataclass(frozen=True, slots=True, kw_only=True)
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
        raise FileProblem(
            "the mesh of a recorded case must lie next to its TOML file", case, field="mesh"
        )
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
