"""The state of a training run as one file, replaced in one step so that a kill leaves a complete
one.
"""

import io
import json
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.files import open_atomic, read_bytes
from pipeline.lab.training.recipe import Recipe

_FILE = "state.pt"
_WHAT = "the training state"
_MAX_BYTES = 32 << 30


@dataclass(slots=True, kw_only=True)
class TrainingState:
    """A run after `step` steps. Holds tensors, numbers and texts only: loading it executes no
    code.
    """

    recipe: str  # as JSON
    command: str = ""
    step: int = 0
    n_examples: int = 0  # seen by all processes
    trained_s: float = 0.0  # over all parts of the run
    device: str = ""  # the GPU; "" = the processor
    n_skipped: int = 0  # steps with a loss or gradient that was not finite
    n_skipped_in_a_row: int = 0
    network_tensors: dict[str, Any] = field(default_factory=dict)
    averaged_tensors: dict[str, Any] = field(default_factory=dict)
    optimiser_state: dict[str, Any] = field(default_factory=dict)
    # over the steps since the last row of the curve
    sums: dict[str, float] = field(default_factory=dict)
    n_summed: int = 0
    curve: list[dict[str, float]] = field(default_factory=list)
    metrics: list[dict[str, Any]] = field(default_factory=list)  # step, split, name, value


def serialise_recipe(recipe: Recipe) -> str:
    """The recipe as JSON; a resumed run must have the same."""
    return json.dumps(recipe.plain_values, sort_keys=True)


def has_state(folder: Path) -> bool:
    """Whether the folder holds a training run."""
    return (folder / _FILE).exists()


def save_state(folder: Path, state: TrainingState) -> None:
    """Replace the state in a folder; raises FileProblem."""
    import torch

    content = io.BytesIO()
    torch.save({f.name: getattr(state, f.name) for f in fields(state)}, content)
    with open_atomic(folder / _FILE, _WHAT, lambda written: load_state(written.parent)) as file:
        file.write(content.getbuffer())


def load_state(folder: Path) -> TrainingState:
    """The state in a folder; raises FileProblem where there is none or it is damaged."""
    import torch

    path = folder / _FILE
    if not path.exists():
        raise FileProblem("this folder holds no training run", folder)
    content = read_bytes(path, _WHAT, _MAX_BYTES)
    try:
        return TrainingState(
            **torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        )
    except Exception as error:  # torch raises several unrelated errors for damaged files
        raise FileProblem(
            f"{_WHAT} is damaged or of another version; train again in another --out", path
        ) from error


def load_for_resume(folder: Path, recipe: Recipe) -> TrainingState:
    """The state in a folder; raises FileProblem, and SettingProblem where its recipe is another
    one.
    """
    state = load_state(folder)
    if state.recipe != serialise_recipe(recipe):
        before = json.loads(state.recipe)
        now = recipe.plain_values
        changes = [
            f"{key}: {before.get(key)} before, {now.get(key)} now"
            for key in now
            if before.get(key) != now.get(key)
        ]
        raise SettingProblem(
            f"the run in {str(folder)!r} has another recipe ({'; '.join(changes)}); "
            "choose another --out, or give that recipe"
        )
    return state
