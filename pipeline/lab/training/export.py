"""Export of a training run as weights with their model card."""

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.core.machine import describe_processor
from pipeline.lab.training import state
from pipeline.lab.training.state import TrainingState
from pipeline.sensors.spec import load_sensor
from pipeline.stages.networks.network_factory import ONNX_KINDS, export_weights
from pipeline.stages.networks.weights import Weights, save_weights
from pipeline.stages.networks.weights_registry import TARGET_KIND


def export_run(folder: Path, to: Path, *, half: bool = False) -> Weights:
    """Write the averaged weights of the run in `folder` with their card, also during the run.

    Raises FileProblem.
    """
    weights = make_weights(state.load_state(folder), to.stem, half=half)
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
    averaged = {key: tensor.detach().cpu() for key, tensor in run.averaged_tensors.items()}
    tensors = {
        key: (tensor.half() if half else tensor).float().numpy().copy()
        for key, tensor in averaged.items()
    }
    weights = Weights(
        name=name, kind=kind, config=recipe["network"], tensors=tensors, card=_card(run, recipe)
    )
    return replace(weights, onnx=export_weights(weights)) if kind in ONNX_KINDS else weights


def _card(run: TrainingState, recipe: Mapping[str, Any]) -> dict[str, str]:
    last = max((int(row["step"]) for row in run.metrics), default=-1)
    figures = {
        f"{row['split'].replace('_', ' ')}: {row['name']}": f"{row['value']:.4g}"
        for row in run.metrics
        if row["step"] == last
    }
    machine = ", ".join(
        part for part in (describe_processor(), f"{os.cpu_count()} cores", run.device) if part
    )
    return {
        "task": str(recipe["task"]),
        "command": run.command,
        "recipe": json.dumps(recipe, sort_keys=True),
        "examples seen": f"{run.n_examples:,}",
        "steps": f"{run.step:,}",
        "minutes": f"{run.trained_s / 60.0:.1f}",
        "machine": machine,
        **_name_target(recipe),
        **figures,
    }


def _name_target(recipe: Mapping[str, Any]) -> dict[str, str]:
    """The kind of the sensor that the network generates touches for; {} for another network."""
    target = recipe["settings"].get("target")
    return {TARGET_KIND: load_sensor(target).kind} if target else {}
