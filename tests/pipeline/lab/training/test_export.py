"""Weights of a run say what their network was trained with."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from pipeline.lab.training.recipe import load_recipe
from pipeline.lab.training.run_folder import TrainingState, make_weights, serialise_recipe
from pipeline.stages.networks.network_factory import build_network, export_weights
from pipeline.stages.networks.weights_registry import TARGET_KIND


@pytest.mark.parametrize(("dropout", "guided"), [(0.1, True), (0.0, False)])
def test_weights_say_whether_guidance_can_act(dropout, guided):
    recipe = load_recipe("latent")
    recipe = replace(recipe, settings=replace(recipe.settings, condition_dropout=dropout))
    run = TrainingState(
        recipe=serialise_recipe(recipe), averaged_tensors={"scale_factor": torch.tensor(1.0)}
    )
    assert make_weights(run, "made").trained_with_condition_dropout == guided


@pytest.mark.parametrize(
    ("name", "kind"), [("latent_t2d2", "bubble"), ("latent_t2d2_gelslim", "gel"), ("pose", None)]
)
def test_the_card_names_the_kind_of_the_target(name, kind):
    run = TrainingState(
        recipe=serialise_recipe(load_recipe(name)), averaged_tensors={"a": torch.tensor(1.0)}
    )
    assert make_weights(run, "made").card.get(TARGET_KIND) == kind


def test_the_onnx_file_holds_the_weights_as_they_are_rounded():
    recipe = load_recipe("bubble")
    network = build_network(
        str(recipe.network["kind"]), {k: v for k, v in recipe.network.items() if k != "kind"}
    )
    run = TrainingState(recipe=serialise_recipe(recipe), averaged_tensors=network.state_dict())
    rounded, exact = (make_weights(run, "made", half=half) for half in (True, False))
    assert rounded.read_onnx() == export_weights(rounded) != exact.read_onnx()
    for name, tensor in rounded.tensors.items():
        assert (tensor == tensor.astype("float16")).all(), name
