"""All that a run has come to, as one file: written beside and moved in, so that a kill always leaves a whole one."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.base.files import open_atomic, read_bytes
from pipeline.training.recipe import Recipe

_FILE = "state.pt"
_WHAT = "the state of the training"
_MOST_BYTES = 32 << 30


@dataclass(slots=True, kw_only=True)
class TrainingState:
    """Where a run stands after `step` steps. Tensors, numbers and words only: it is read without running any code."""

    recipe: str  # in words, as JSON: what the run was begun with
    command: str = ""
    step: int = 0
    n_examples: int = 0  # seen, by all devices
    trained_s: float = 0.0  # trained, of all parts of the run
    device: str = ""  # the card that it was trained on; "" = the processor
    n_skipped: int = 0  # steps whose gradient was no number
    n_skipped_in_a_row: int = 0
    network_tensors: dict[str, Any] = field(default_factory=dict)
    averaged_tensors: dict[str, Any] = field(default_factory=dict)
    optimiser_state: dict[str, Any] = field(default_factory=dict)
    sums: dict[str, float] = field(default_factory=dict)  # of the rows that the next line of the curve is the mean of
    n_summed: int = 0
    curve: list[dict[str, float]] = field(default_factory=list)
    metrics: list[dict[str, Any]] = field(default_factory=list)  # step, split, name, value


def serialise_recipe(recipe: Recipe) -> str:
    """What of a recipe a run must be gone on with unchanged."""
    return json.dumps(recipe.plain_values, sort_keys=True)


def has_state(folder: Path) -> bool:
    """Whether a run was begun in this folder."""
    return (folder / _FILE).exists()


def save_state(folder: Path, state: TrainingState) -> None:
    """Write the state in the place of the one before; raises FileProblem."""
    import torch

    content = io.BytesIO()
    torch.save({f.name: getattr(state, f.name) for f in fields(state)}, content)
    with open_atomic(folder / _FILE, _WHAT) as file:
        file.write(content.getbuffer())


def load_state(folder: Path) -> TrainingState:
    """The state in a folder; raises FileProblem where there is none, or one that is damaged."""
    import torch

    path = folder / _FILE
    if not path.exists():
        raise FileProblem("no training was begun here", folder)
    content = read_bytes(path, _WHAT, _MOST_BYTES)
    try:
        return TrainingState(**torch.load(io.BytesIO(content), map_location="cpu", weights_only=True))
    except Exception as error:  # torch's errors of a damaged file have no common root
        raise FileProblem(
            f"{_WHAT} is damaged or was written by another version; begin anew in another --out", path
        ) from error


def load_for_resume(folder: Path, recipe: Recipe) -> TrainingState:
    """The state in a folder, checked to be of the same recipe; raises FileProblem and SettingProblem."""
    state = load_state(folder)
    if state.recipe != serialise_recipe(recipe):
        before, now = json.loads(state.recipe), recipe.plain_values
        other = [
            f"{key}: {before.get(key)} before, {now.get(key)} now" for key in now if before.get(key) != now.get(key)
        ]
        raise SettingProblem(
            f"the training in {str(folder)!r} was begun with another recipe ({'; '.join(other)}); "
            "choose another --out, or give that recipe"
        )
    return state
