"""From a run to weights with their card."""

from __future__ import annotations

import json
import os
from pathlib import Path

from pipeline.base.processor import processor
from pipeline.networks.weights import Weights, save
from pipeline.training import state
from pipeline.training.state import State


def export(folder: Path, to: Path, *, half: bool = False) -> Weights:
    """Write the averaged weights of the run in `folder` with their card, also while it goes on; raises FileProblem."""
    weights = weights_of(state.load(folder), to.stem)
    save(to, weights, half=half)
    return weights


def weights_of(run: State, name: str) -> Weights:
    """The averaged weights of a run."""
    recipe = json.loads(run.recipe)
    kind = str(recipe["network"].pop("kind"))
    tensors = {key: tensor.detach().float().cpu().numpy().copy() for key, tensor in run.average.items()}
    return Weights(name=name, kind=kind, config=recipe["network"], tensors=tensors, card=_card(run, recipe))


def _card(run: State, recipe: dict[str, object]) -> dict[str, str]:
    last = max((int(row["step"]) for row in run.figures), default=-1)
    figures = {f"{row['split'].replace('_', ' ')}: {row['name']}": f"{row['value']:.4g}" for row in run.figures
               if row["step"] == last}  # fmt: skip
    machine = ", ".join(part for part in (processor(), f"{os.cpu_count()} cores", run.device) if part)
    return {
        "task": str(recipe["task"]), "command": run.command, "recipe": json.dumps(recipe, sort_keys=True),
        "examples seen": f"{run.examples:,}", "steps": f"{run.step:,}",
        "minutes": f"{run.seconds / 60.0:.1f}", "machine": machine,
        **figures,
    }  # fmt: skip
