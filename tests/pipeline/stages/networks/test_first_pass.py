"""The first pass of a residual denoiser from its ONNX file."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.core.errors import ModelMissing
from pipeline.stages.networks.network_factory import (
    build_network,
    export_weights,
    load_network,
    load_predictor,
)
from pipeline.stages.networks.onnx_predictor import FirstPassPredictor
from pipeline.stages.networks.samplers import raise_steps
from pipeline.stages.networks.weights import Weights
from pipeline.stages.touch.residual_diffusion import DiffusionParams, sample_residual

RNG = np.random.default_rng(0)
CONDITION = RNG.normal(size=(3, 24, 31)).astype(np.float32)


@pytest.fixture(scope="module")
def weights() -> Weights:
    config = {
        "inputs": 3,
        "unit_mm": 0.5,
        "base_channels": 8,
        "levels": 3,
        "max_channels": 16,
        "sigma_max": 10.0,
        "error_exponent": 2.0,
    }
    torch.manual_seed(0)
    net = build_network("residual_denoiser", config)
    for tensor in net.parameters():
        tensor.data.add_(0.05 * torch.randn_like(tensor))
    tensors = {name: tensor.numpy().copy() for name, tensor in net.state_dict().items()}
    made = Weights(name="small", kind="residual_denoiser", config=config, tensors=tensors)
    return replace(made, onnx=export_weights(made))


def test_one_step_is_that_of_torch(weights):
    predictor = load_predictor(weights)
    network = load_network(weights)
    assert isinstance(predictor, FirstPassPredictor)
    assert (predictor.unit_mm, predictor.error_exponent, predictor.sigma_min) == (
        0.5,
        2.0,
        network.sigma_min,
    )
    ours, theirs = (
        sample_residual(net, CONDITION, DiffusionParams(keep_states=True))
        for net in (predictor, network)
    )
    for name in ("residual_mm", "contact_correction", "sigma"):
        assert getattr(ours.final, name) == pytest.approx(getattr(theirs.final, name), abs=2e-4)
        assert getattr(ours.states[0], name) == pytest.approx(
            getattr(theirs.states[0], name), abs=2e-4
        )
    assert ours.expected_error_mm == pytest.approx(theirs.expected_error_mm, rel=1e-3)


def test_more_steps_are_those_of_the_whole_network(weights):
    params = DiffusionParams(steps=5, guidance=2.0)
    ours, theirs = (
        sample_residual(net(weights), CONDITION, params) for net in (load_predictor, load_network)
    )
    assert np.array_equal(ours.final.residual_mm, theirs.final.residual_mm)


def test_the_default_touch_needs_no_torch():
    code = """
import sys
from app.session.sample import SAMPLE_RECORDING
from pipeline.translation.translate import Request, open_translation
opened = open_translation(Request(recording=SAMPLE_RECORDING, source="gelslim", target="soft_bubble", route="t2d2"))
touch = opened[5].result("touch")
assert touch.method.name == "t2d2" and touch.badge.startswith("network correction"), touch.notes
assert "torch" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=240)


@pytest.mark.parametrize(
    ("guidance", "steps", "raised"), [(2.0, 1, 8), (2.0, 0, 8), (2.0, 4, 4), (1.0, 1, 1)]
)
def test_changed_guidance_gets_the_steps_that_it_needs(guidance, steps, raised):
    old = DiffusionParams(steps=steps, guidance=1.5)
    assert raise_steps(old, replace(old, guidance=guidance)).steps == raised
    assert raise_steps(old, replace(old, seed=3)).steps == steps


def test_settings_of_another_version_are_named():
    with pytest.raises(ModelMissing, match="blur_px"):
        build_network("residual_denoiser", {"inputs": 6, "unit_mm": 0.2, "blur_px": 0.75})
