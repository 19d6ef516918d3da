"""Recorded pairs as touches to score: one selection of frames per tool and finger, held out as a
training was.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from pipeline.core.errors import SettingProblem
from pipeline.lab.evaluation.held_out import PressRecordings, TouchSet
from pipeline.lab.evaluation.published_results import PAPER_DIRECTIONS, Split
from pipeline.lab.training.recorded_pairs import NoPairs, PairFolder, PairPlace, PairSet, open_pairs
from pipeline.stages.networks import weights_registry
from pipeline.stages.networks.weights import NoWeights


def select_recorded(pairs: PairSet, of: TouchSet) -> tuple[PressRecordings, ...]:
    """The pairs of a role; () where it has none."""
    groups: dict[tuple[str, str, str], list[PairPlace]] = {}
    for place in pairs.places.get(of, ()):
        groups.setdefault(
            (str(place.recording.path), place.grasp.tool, place.source_stream.name), []
        ).append(place)
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
