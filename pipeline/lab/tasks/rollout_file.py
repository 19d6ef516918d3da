"""Rollouts as recordings: the frames of all sensors, and in the group `rollout` what the robot did.

    /rollout                 summary (JSON: outcome, decisions, attribution), plan (JSON), key
                             (digest of the plan)
        time                 (n,) "s"
        world_from_object    (n, 4, 4) "mm"
        world_from_hand      (n, 4, 4) "mm"
        commanded            (n, 4, 4) "mm", the hand as commanded
        force                (n, 3) "N" on the object, world axes
        world_from_NAME      (n, 4, 4) "mm", another moving body of this name

Frame `i` of the streams is the moment of decision `i`. A plan names a TOML case by its file name,
without its folder.
"""

import contextlib
import json
from collections.abc import Generator, Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import FileProblem, TouchError
from pipeline.core.files import require_budget, require_file
from pipeline.core.typed_data import convert
from pipeline.io import hdf5, hdf5_layout
from pipeline.io.hdf5_writer import RecordingWriter
from pipeline.lab.recorder import BUBBLE_STEP_MM
from pipeline.lab.tasks.task import RecordedRollout, Rollout, RolloutSummary, TrialPlan

GROUP = "rollout"
CASE_SUFFIX = ".toml"
_BODY = "world_from_"  # of a dataset's name
# dataset -> field of a tick and of a recorded rollout, unit, shape of one tick
_TABLES: dict[str, tuple[str, str, tuple[int, ...]]] = {
    "time": ("time_s", "s", ()),
    "world_from_object": ("world_from_object", "mm", (4, 4)),
    "world_from_hand": ("world_from_hand", "mm", (4, 4)),
    "commanded": ("commanded", "mm", (4, 4)),
    "force": ("force_n", "N", (3,)),
}
_DIGITS = 6  # of numbers in a summary: equal on machines whose last bits differ


def summarise(rollout: Rollout) -> dict[str, object]:
    """What a table and `--json` show of a rollout."""
    stated = {field.name: getattr(rollout, field.name) for field in fields(RolloutSummary)}
    return _round({**stated, "decisions": [asdict(decision) for decision in rollout.decisions]})


def write_rollout(rollout: Rollout, path: Path, key: str, plan: TrialPlan) -> None:
    """Write a rollout and the plan that it is of.

    Raises FileProblem where nothing can be written.
    """
    ticks = rollout.ticks
    tables = {
        name: (np.array([getattr(tick, field) for tick in ticks]), unit)
        for name, (field, unit, _) in _TABLES.items()
    }
    for body in ticks[0].world_from_bodies if ticks else ():
        poses = np.array([tick.world_from_bodies[body] for tick in ticks])
        tables[f"{_BODY}{body}"] = (poses, "mm")
    own = replace(
        plan,
        touches=(rollout.touch,),
        tolerances_mm=(rollout.tolerance_mm,),
        case=_name_case(plan.case),
    )
    summary = json.dumps(summarise(rollout))
    with RecordingWriter(
        path,
        object_mesh=rollout.mesh,
        pairings=rollout.pairings,
        notes=(f"rollout: {rollout.cause}",),
        coding="row differences",
        depth_step_mm=BUBBLE_STEP_MM,
    ) as writer:
        for stream, frame, truth in rollout.frames:
            writer.append(stream, frame, truth)
        attributes = {"summary": summary, "plan": json.dumps(asdict(own)), "key": key}
        writer.write_group(GROUP, tables, attributes)


def _name_case(case: str) -> str:
    return Path(case).name if case.endswith(CASE_SUFFIX) else case


def read_rollout(path: Path) -> RecordedRollout:
    """A recorded rollout with all ticks.

    Raises FileProblem for another file, and for a damaged one.
    """
    with contextlib.closing(hdf5.read(path)) as recording:
        mesh = recording.object_mesh
    with _open_group(path) as group:
        plan = _read_plan(group, path)
        summary = _read_summary(group, path)
        tables = {
            field: _read_table(group, name, unit, shape, path)
            for name, (field, unit, shape) in _TABLES.items()
        }
        bodies = {
            name.removeprefix(_BODY): _read_table(group, name, "mm", (4, 4), path)
            for name in group
            if name.startswith(_BODY) and name not in _TABLES
        }
    n = len(tables["time_s"])
    if n == 0 or {len(table) for table in (*tables.values(), *bodies.values())} != {n}:
        raise FileProblem("the rollout's tables have different lengths, or none", path)
    if not all(0 <= decision.tick < n for decision in summary.decisions):
        raise FileProblem(f"a decision of the rollout lies outside its {n} ticks", path)
    return RecordedRollout(
        path=path, plan=plan, summary=summary, mesh=mesh, world_from_bodies=bodies, **tables
    )


def list_places(path: Path) -> Mapping[str, str]:
    """Stream of the source -> title, for every finger or plate of a rollout that records two
    sensors.
    """
    with contextlib.closing(hdf5.read(path)) as recording:
        sensors = {stream.name: stream.sensor for stream in recording.streams}
        sources = [pair.source for pair in recording.pairings if pair.source in sensors]
        return {name: name.removeprefix(f"{sensors[name]}_").replace("_", " ") for name in sources}


def read_outcome(path: Path) -> tuple[TrialPlan, RolloutSummary]:
    """Plan and summary of a recorded rollout without its ticks; raises FileProblem."""
    with _open_group(path) as group:
        return _read_plan(group, path), _read_summary(group, path)


def may_be_rollout(path: Path) -> bool:
    """Whether an HDF5 file is a recorded rollout, or so damaged that it may have been one."""
    import h5py

    with contextlib.suppress(OSError, RuntimeError), h5py.File(path, "r") as file:
        return GROUP in file
    return True


@contextlib.contextmanager
def _open_group(path: Path) -> Generator[Any]:
    import h5py

    require_file(path, "the rollout", most_bytes=1 << 50)
    try:
        with h5py.File(path, "r") as file:
            hdf5_layout.require_self_contained(file, path)
            if GROUP not in file:
                raise FileProblem(
                    "this is no rollout of a task; `tactoscope task --record` writes some", path
                )
            group: Any = file[GROUP]
            n_bytes = sum(
                16 * int(part.size or 0)
                for part in group.values()
                if isinstance(part, h5py.Dataset)
            )
            require_budget(n_bytes, "the rollout's tables", path)
            yield group
    except TouchError:
        raise
    except (OSError, RuntimeError, LookupError, ValueError, TypeError, AttributeError) as error:
        raise FileProblem("the rollout is damaged or cut off", path) from error


def _read_plan(group: Any, path: Path) -> TrialPlan:
    if "plan" not in group.attrs:
        raise FileProblem(
            "the rollout is of an older version and lacks its plan; run the task again", path
        )
    plan = convert(json.loads(str(group.attrs["plan"])), TrialPlan, "the plan of the rollout", path)
    case = _name_case(plan.case)  # a file names no other folder
    return replace(plan, case=str(path.parent / case) if case.endswith(CASE_SUFFIX) else case)


def _read_summary(group: Any, path: Path) -> RolloutSummary:
    return convert(
        json.loads(str(group.attrs["summary"])), RolloutSummary, "the summary of the rollout", path
    )


def _read_table(group: Any, key: str, unit: str, shape: tuple[int, ...], path: Path) -> Doubles:
    if key not in group:
        raise FileProblem(f"the rollout has no table {key!r}", path)
    table = hdf5_layout.require_dataset(
        group, key, unit, hdf5_layout.FLOAT_KINDS, (None, *shape), path
    )[()]
    if not np.isfinite(table).all():
        raise FileProblem(
            f"the rollout's table {key!r} holds numbers that are not finite",
            path,
        )
    return freeze(table.astype(np.float64))


def read_summary(path: Path, key: str) -> Mapping[str, Any] | None:
    """The summary of a rollout that was run with this key.

    None for another one or a file that cannot be read.
    """
    import h5py

    # one that cannot be read is written again
    with contextlib.suppress(Exception), h5py.File(path, "r") as file:
        attributes = file[GROUP].attrs
        if attributes["key"] == key:
            return json.loads(str(attributes["summary"]))
    return None


def _round(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, _DIGITS) + 0.0
    if isinstance(value, Mapping):
        return {key: _round(one) for key, one in value.items()}
    return [_round(one) for one in value] if isinstance(value, list | tuple) else value
