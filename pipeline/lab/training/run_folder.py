"""The folder of a training run: its state, its curves, and the weights that are exported from it.

The state is one file, replaced in one step so that a kill leaves a complete one.
"""

import csv
import io
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.figures import make_figure, save_figure
from pipeline.core.files import open_atomic, read_bytes, write_text
from pipeline.core.machine import describe_processor
from pipeline.lab.training.recipe import Recipe
from pipeline.sensors.spec import load_sensor
from pipeline.stages.networks.network_factory import ONNX_KINDS, export_weights
from pipeline.stages.networks.weights import Weights, save_weights
from pipeline.stages.networks.weights_registry import TARGET_KIND

_FILE = "state.pt"
_WHAT = "the training state"
_MAX_BYTES = 32 << 30
# of the figure of the curves
_INCHES = (9.0, 3.0)
_DPI = 110


@dataclass(slots=True, kw_only=True)
class TrainingState:
    """A run after `step` steps. Holds tensors, numbers and texts only: loading it executes no
    code.
    """

    recipe: str  # as JSON
    command: str = ""
    step: int = 0
    n_examples: int = 0
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

    def list_last_metrics(self) -> dict[str, float]:
        """Split with name -> value of the last validation."""
        last = max((row["step"] for row in self.metrics), default=-1)
        return {
            f"{row['split'].replace('_', ' ')}: {row['name']}": row["value"]
            for row in self.metrics
            if row["step"] == last
        }


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
    content = io.BytesIO(read_bytes(path, _WHAT, _MAX_BYTES))
    try:
        return TrainingState(**torch.load(content, map_location="cpu", weights_only=True))
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
        changes = [
            f"{key}: {before.get(key)} before, {value} now"
            for key, value in recipe.plain_values.items()
            if before.get(key) != value
        ]
        raise SettingProblem(
            f"the run in {str(folder)!r} has another recipe ({'; '.join(changes)}); "
            "choose another --out, or give that recipe"
        )
    return state


def write_tables(folder: Path, state: TrainingState) -> None:
    """Write `curve.csv` (loss and its terms) and `figures.csv` (step, split, name, value).

    Raises FileProblem.
    """
    rows: Sequence[Mapping[str, Any]]
    for file, rows in (("curve.csv", state.curve), ("figures.csv", state.metrics)):
        text = io.StringIO()
        names = dict.fromkeys(name for row in rows for name in row)
        table = csv.DictWriter(text, list(names), lineterminator="\n")
        table.writeheader()
        for row in rows:
            table.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()})
        write_text(folder / file, text.getvalue(), "the learning curves", None)


def draw_curves(folder: Path, state: TrainingState) -> None:
    """Write `curve.png`: the loss, and below it every validation metric; raises FileProblem."""
    rows = [("loss", "training", row["step"], row["loss"]) for row in state.curve]
    rows += [
        (row["name"], row["split"].replace("_", " "), row["step"], row["value"])
        for row in state.metrics
    ]
    panels: dict[str, dict[str, list[tuple[float, float]]]] = {}
    for name, line, step, value in rows:
        panels.setdefault(name, {}).setdefault(line, []).append((step, value))
    figure = make_figure(
        figsize=(_INCHES[0], _INCHES[1] * len(panels)), dpi=_DPI, layout="constrained"
    )
    figure.suptitle(f"{state.n_examples:,} examples in {state.trained_s / 60.0:.0f} minutes")
    axes: Any = figure.subplots(len(panels), 1, squeeze=False, sharex=True)[:, 0]
    for axis, (name, lines) in zip(axes, panels.items(), strict=True):
        for label, points in lines.items():
            axis.plot(*zip(*points, strict=True), marker=".", label=label)
        axis.set(ylabel=name, xlabel="step")
        axis.legend(frameon=False)
        axis.grid(visible=True, alpha=0.3)
    save_figure(figure, folder / "curve.png", "the learning curves")


def export_run(folder: Path, to: Path, *, half: bool = False) -> Weights:
    """Write the averaged weights of the run in `folder` with their card, also during the run.

    Raises FileProblem.
    """
    weights = make_weights(load_state(folder), to.stem, half=half)
    save_weights(to, weights, use_float16=half)
    return weights


def make_weights(run: TrainingState, name: str, *, half: bool = False) -> Weights:
    """The averaged weights of a run.

    `half` rounds them to 16 bits first, so that the ONNX file agrees with them.
    """
    recipe = json.loads(run.recipe)
    kind = str(recipe["network"].pop("kind"))
    if recipe["settings"].get("condition_dropout") == 0.0:
        recipe["network"]["trained_with_condition_dropout"] = False
    tensors = {
        key: (tensor.half() if half else tensor).float().cpu().numpy().copy()
        for key, tensor in run.averaged_tensors.items()
    }
    machine = (describe_processor(), f"{os.cpu_count()} cores", run.device)
    card = {
        "task": str(recipe["task"]),
        "command": run.command,
        "recipe": json.dumps(recipe, sort_keys=True),
        "examples seen": f"{run.n_examples:,}",
        "steps": f"{run.step:,}",
        "minutes": f"{run.trained_s / 60.0:.1f}",
        "machine": ", ".join(filter(None, machine)),
    }
    target = recipe["settings"].get("target")
    if target:  # of a network that generates touches
        card[TARGET_KIND] = load_sensor(target).kind
    card |= {name: f"{value:.4g}" for name, value in run.list_last_metrics().items()}
    weights = Weights(name=name, kind=kind, config=recipe["network"], tensors=tensors, card=card)
    return replace(weights, onnx=export_weights(weights)) if kind in ONNX_KINDS else weights
