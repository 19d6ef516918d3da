"""Candidates of the evaluation: every touch method with weights of the direction, and the
baselines.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from pipeline.core.arrays import Floats, freeze
from pipeline.core.derived import derive_once
from pipeline.core.errors import SettingProblem
from pipeline.io import open_recording
from pipeline.lab.evaluation.held_out import PressRecordings
from pipeline.lab.evaluation.published_results import PAPER_MODELS
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.networks.weights import NoWeights
from pipeline.translation.catalogue import BUILT_IN

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A touch method or a baseline."""

    name: str  # a touch method, or RECORDED, OWN, NO_CONTACT or MEAN_TOUCH
    title: str
    paper_model: str = ""  # model of the paper, "" = none


@dataclass(frozen=True, slots=True, kw_only=True)
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
    total = None
    count = 0
    kind = load_sensor(target).sensor_kind
    for of in recordings:
        recording = open_recording(of.target)
        try:
            stream = recording.stream(of.target_stream or target)
            for index in of.target_frames or range(stream.n_frames):
                frame = stream.frame(index)
                assert frame.reference is not None
                one = kind.compute_relative_change(frame.image, frame.reference).astype(np.float64)
                total = one if total is None else total + one
                count = count + 1
        finally:
            recording.close()
    if total is None:
        raise SettingProblem("the recordings hold no touch for the mean")
    return freeze((total / count).astype(np.float32))
