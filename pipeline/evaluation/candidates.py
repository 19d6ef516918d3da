"""Who is scored: every touch method that knows the direction, and what any of them must beat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from pipeline.base.arrays import Floats, freeze
from pipeline.base.errors import SettingProblem
from pipeline.engine.graph import Method
from pipeline.evaluation.published_results import PAPER_MODELS
from pipeline.networks.square_images import compute_change
from pipeline.networks.weights import NoWeights
from pipeline.recordings import open_recording
from pipeline.sensors.spec import SensorSpec
from pipeline.translation.catalogue import BUILT_IN, Catalogue

RECORDED, NO_CONTACT, MEAN_TOUCH = "recorded", "untouched", "mean"
_GIVEN = {
    RECORDED: "the target's own touch", NO_CONTACT: "untouched picture", MEAN_TOUCH: "mean of other touches",
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """One way to a touch of the target."""

    name: str  # a method of the slot touch, or one of RECORDED, UNTOUCHED and MEAN
    title: str
    paper_model: str = ""  # of the paper, "" = it has no such row


@dataclass(frozen=True, slots=True, kw_only=True)
class CandidateSet:
    """Those of one direction, and who cannot take part and why."""

    candidates: tuple[Candidate, ...]
    excluded: tuple[str, ...]  # sentences


def select_candidates(
    source: SensorSpec, target: SensorSpec, only: Sequence[str] = (), catalogue: Catalogue = BUILT_IN
) -> CandidateSet:
    """Baselines, then the catalogue's methods in its order; `only` names some of all. Raises SettingProblem."""
    methods: tuple[Method, ...] = catalogue.stage("touch").methods
    unknown = set(only) - {*_GIVEN, *(m.name for m in methods)}
    if unknown:
        known = ", ".join((*_GIVEN, *(m.name for m in methods)))
        raise SettingProblem(f"no way to a touch is called {sorted(unknown)[0]!r}; there are {known}")
    made = [Candidate(name=name, title=title) for name, title in _GIVEN.items()]
    absent: list[str] = []
    for method in methods:
        found = None if method.weights is None else method.weights(source, target, None)
        if isinstance(found, NoWeights):
            absent.append(f"{source.name} to {target.name} by {method.name}: {found.why}")
        else:
            made.append(Candidate(name=method.name, title=method.title, paper_model=PAPER_MODELS.get(method.name, "")))
    return CandidateSet(
        candidates=tuple(c for c in made if not only or c.name in only),
        excluded=tuple(why for why in absent if not only or why.split(":")[0].split()[-1] in only),
    )


@lru_cache(maxsize=8)
def compute_mean_change(usual: tuple[Path, ...], target: str) -> Floats:
    """(rows, cols, channels): the mean change of a sensor's reading over recordings of other touches."""
    total, count = None, 0
    for path in usual:
        recording = open_recording(path)
        try:
            stream = recording.stream(target)
            for index in range(stream.n_frames):
                frame = stream.frame(index)
                assert frame.reference is not None
                one = compute_change("bubble" if frame.is_depth else "gel", frame.image, frame.reference).astype(
                    np.float64
                )
                total, count = one if total is None else total + one, count + 1
        finally:
            recording.close()
    if total is None:
        raise SettingProblem("there is no touch to take the mean of")
    return freeze((total / count).astype(np.float32))
