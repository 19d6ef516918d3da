"""What is scored: held-out touches that no method was trained on, simulated once and cached or
recorded as pairs, and the candidates, every touch method with weights of the direction and the
baselines.
"""

import json
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from pipeline.core import disk_store
from pipeline.core.arrays import Floats, freeze
from pipeline.core.derived import derive_once
from pipeline.core.digests import compute_digest
from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.files import set_aside
from pipeline.core.frozen import frozen
from pipeline.core.params import check_range
from pipeline.core.progress import SILENT, Progress, SubProgress
from pipeline.io import open_recording
from pipeline.lab import recorder
from pipeline.lab.evaluation.published_results import PAPER_DIRECTIONS, PAPER_MODELS, Split
from pipeline.lab.training.recorded_pairs import NoPairs, PairFolder, PairPlace, PairSet, open_pairs
from pipeline.physics.simulation import datasets
from pipeline.physics.simulation.datasets import SimulationPlan
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.networks import weights_registry
from pipeline.stages.networks.weights import NoWeights
from pipeline.translation.catalogue import BUILT_IN

SENSORS = ("gelslim", "soft_bubble", "digit")
_TARGETS = SENSORS[:2]
MAX_GRASPS = 1000
MAX_SEED = 1_000_000
# "training": touches of training objects, for the mean touch
TouchSet = Split | Literal["training"]
_SEEDS: dict[str, int] = {"unseen_grasps": 40_001, "unseen_tools": 40_002, "training": 40_003}

_SEED_STEP = 100_000  # so that no seed of one set is that of another


@frozen
class HeldOutOptions:
    """Number of touches, and the sensor instances."""

    grasps: int = 5  # of each object
    sensor_variation: float = (
        # how far a source differs from the described unit, 1 = as those of a lab; a target never
        # does
        1.0
    )
    seed: int = 0  # of the touches to score; those of the mean touch stay the same
    folder: Path | None = None  # where they are kept; None = the user's cache


@frozen
class PressRecordings:
    """The same presses of one object by both sensors: simulated by two instances each, or
    recorded as pairs.
    """

    object_name: str
    source: Path
    target: Path
    source_stream: str = ""  # name of the stream; "" = the first one of the sensor
    target_stream: str = ""
    frames: tuple[int, ...] = ()  # of the source; () = all
    target_frames: tuple[int, ...] = ()  # their partners
    # touches of one grasp have one name; () = every frame is a touch of its own
    frame_names: tuple[str, ...] = ()
    mesh: Path | None = None  # of the object, in metres; None = the recording's


def select_sensors(source: str, target: str) -> tuple[str, ...]:
    """Return the sensors that record a direction: `SENSORS`, or the default targets and both
    sensors of it.
    """
    return (
        SENSORS
        if {source, target} <= set(SENSORS)
        else tuple(dict.fromkeys((*_TARGETS, source, target)))
    )


def load_or_simulate(
    of: TouchSet,
    held_out: HeldOutOptions,
    progress: Progress = SILENT,
    sensors: tuple[str, ...] = SENSORS,
) -> tuple[PressRecordings, ...]:
    """Recordings of every object by all `sensors` at once; missing ones are simulated.

    Sources are varied sensor instances. Touches are generated for the described target, so the
    described instance records what they are compared with. Raises SettingProblem for an invalid
    number of grasps, FileProblem if the folder cannot be written.
    """
    check_range("--grasps", held_out.grasps, 1, MAX_GRASPS)
    check_range("--seed", held_out.seed, 0, MAX_SEED)
    template = SimulationPlan(
        sensors=sensors,
        object_source="",
        n_poses=held_out.grasps,
        seed=_SEEDS[of] + _SEED_STEP * held_out.seed,
        vary=held_out.sensor_variation,
    )
    plans = datasets.make_plans(("unseen" if of == "unseen_tools" else "training",), template)
    recordings: list[PressRecordings] = []
    for index, plan in enumerate(plans):
        name = plan.object_name
        part = SubProgress(progress, index / len(plans), 1.0 / len(plans), f"simulating {name}")
        source, target = (
            _load_or_record(of, variant, held_out.folder, part)
            for variant in (plan, replace(plan, vary=0.0))
        )
        recordings.append(PressRecordings(object_name=name, source=source, target=target))
    return tuple(recordings)


def _load_or_record(
    of: TouchSet, plan: SimulationPlan, folder: Path | None, progress: Progress
) -> Path:
    # The name contains a digest of the plan: recordings of another plan are neither used nor
    # overwritten.
    name = f"{of}_{plan.object_name}_{compute_digest(datasets.describe_plan(plan))[:8]}.h5"
    path = (folder or disk_store.cache_folder() / "held_out") / name
    try:
        done = recorder.count_finished_moments(plan, path)
    except FileProblem:  # a damaged recording of this cache
        done = 0
        _ = set_aside(path)
    if done < plan.n_poses:
        recorder.record_plan(plan, path, progress=progress)
    return path


def select_recorded(pairs: PairSet, of: TouchSet) -> tuple[PressRecordings, ...]:
    """The pairs of a role; () where it has none."""
    groups: dict[tuple[str, str, str], list[PairPlace]] = {}
    for place in pairs.places.get(of, ()):
        key = str(place.recording.path), place.grasp.tool, place.source_stream.name
        groups.setdefault(key, []).append(place)
    return tuple(_select(sorted(group, key=lambda place: place.index)) for group in groups.values())


def _select(places: Sequence[PairPlace]) -> PressRecordings:
    first = places[0]
    return PressRecordings(
        object_name=first.grasp.tool,
        source=first.recording.path,
        target=first.recording.path,
        source_stream=first.source_stream.name,
        target_stream=first.target_stream.name,
        frames=tuple(place.index for place in places),
        target_frames=tuple(place.target_index for place in places),
        frame_names=tuple(place.grasp.name for place in places),
        mesh=None if first.recording.object_mesh is not None else first.grasp.mesh_file,
    )


def open_directions(
    folder: PairFolder, directions: Sequence[tuple[str, str]]
) -> dict[tuple[str, str], PairSet]:
    """The pairs of every direction.

    Of the paper's directions those that are recorded. Raises SettingProblem.
    """
    found: dict[tuple[str, str], PairSet] = {}
    problem = NoPairs("no direction is given")
    for direction in directions or PAPER_DIRECTIONS:
        try:
            found[direction] = open_pairs(folder, *direction)
        except NoPairs as error:
            if directions:
                raise
            problem = error
    if not found:
        raise problem
    return found


def find_trained_hold_out(weights: Mapping[str, Path]) -> str:
    """What trainings on recorded pairs held out, from the cards of their weights.

    "" where none was.

    Raises SettingProblem where they held out different pairs: the touches of one were trained on by
    another.
    """
    held_out: dict[str, str] = {}
    for name, file in weights.items():
        loaded = weights_registry.load_file(file)
        if isinstance(loaded, NoWeights):
            continue
        pairs = json.loads(loaded.card.get("recipe", "{}")).get("data", {})
        if "pairs" in pairs:
            held_out[name] = pairs["hold_out"]
    if len(set(held_out.values())) > 1:
        texts = ", ".join(
            f"{name}: {value or 'splits of the folder'}" for name, value in held_out.items()
        )
        raise SettingProblem(
            f"the weights held out different pairs ({texts}); give --hold-out, or train them alike"
        )
    return next(iter(held_out.values()), "")


def require_touches(pairs: PairSet, split: Split) -> None:
    """Raise SettingProblem where a split has no pairs."""
    if not pairs.places.get(split):
        raise SettingProblem(
            f"no {split.replace('_', ' ')} are held out ({pairs.notes[0]}); choose another "
            "--hold-out or --split"
        )


RECORDED = "recorded"
OWN = "own"
NO_CONTACT = "no_contact"
MEAN_TOUCH = "mean"
BASELINES = (NO_CONTACT, MEAN_TOUCH)  # need no source
_TITLES = {
    RECORDED: "recorded touch",
    OWN: "own sensor, no translation",
    NO_CONTACT: "reference image",
    MEAN_TOUCH: "mean of other touches",
}


@frozen
class Candidate:
    """A touch method or a baseline."""

    name: str  # a touch method, or RECORDED, OWN, NO_CONTACT or MEAN_TOUCH
    title: str
    paper_model: str = ""  # model of the paper, "" = none


@frozen
class CandidateSet:
    """Candidates of one direction, and which methods are excluded."""

    candidates: tuple[Candidate, ...]
    excluded: Mapping[str, str]  # method -> a sentence


def select_candidates(
    source: SensorSpec,
    target: SensorSpec,
    only: Sequence[str] = (),
    weights: Mapping[str, Path] = MappingProxyType({}),
) -> CandidateSet:
    """Baselines, then the catalogue's methods in its order; `only` names some of all.

    `weights` (method -> file) replace shipped ones.
    """
    candidates = [Candidate(name=name, title=title) for name, title in _TITLES.items()]
    excluded: dict[str, str] = {}
    for method in BUILT_IN.stage("touch").methods:
        found = method.weights and method.weights(source, target, weights.get(method.name))
        if isinstance(found, NoWeights):
            excluded[method.name] = f"{source.name} to {target.name} by {method.name}: {found.why}"
        else:
            model = PAPER_MODELS.get(method.name, "")
            candidates.append(Candidate(name=method.name, title=method.title, paper_model=model))
    return CandidateSet(
        candidates=tuple(c for c in candidates if not only or c.name in only),
        excluded={name: why for name, why in excluded.items() if not only or name in only},
    )


def check_candidate_names(names: Sequence[str]) -> None:
    """Check that each name is a baseline or a method of the catalogue; raises SettingProblem."""
    known = [*_TITLES, *(m.name for m in BUILT_IN.stage("touch").methods)]
    unknown = sorted(set(names) - set(known))
    if unknown:
        raise SettingProblem(f"no candidate is called {unknown[0]!r}; there are {', '.join(known)}")


@derive_once
def compute_mean_change(recordings: tuple[PressRecordings, ...], target: str) -> Floats:
    """Mean change from the reference (rows, cols, channels) of a sensor's frames over recordings
    of other touches.
    """
    total: Any = 0.0
    count = 0
    kind = load_sensor(target).sensor_kind
    for of in recordings:
        with closing(open_recording(of.target)) as recording:
            stream = recording.stream(of.target_stream or target)
            for index in of.target_frames or range(stream.n_frames):
                frame = stream.frame(index)
                assert frame.reference is not None
                change = kind.compute_relative_change(frame.image, frame.reference)
                total = total + change.astype(np.float64)
                count += 1
    if not count:
        raise SettingProblem("the recordings hold no touch for the mean")
    return freeze((total / count).astype(np.float32))
