"""Sliders of a diffusion method: drafts while dragged, full results when released, kept steps."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtWidgets import QSlider

from app.window.tour import wait_until_shown
from pipeline.networks.weights import Weights, save_weights
from pipeline.stages.touch.depth_condition import CONDITION_CHANNELS
from pipeline.stages.touch.residual_diffusion import DiffusionParams

LIMIT_S = 240
KEY = "touch/t2d2"


@pytest.fixture(scope="module")
def weights_file(tmp_path_factory):
    """Weights of a small untrained network."""
    import torch

    from pipeline.networks.network_factory import build_network

    config = {"inputs": CONDITION_CHANNELS, "unit_mm": 0.2, "base_channels": 4, "levels": 2, "max_channels": 8}
    torch.manual_seed(0)
    net = build_network("residual_denoiser", config)
    torch.nn.init.normal_(net.finish.weight, std=0.1)
    tensors = {name: tensor.float().numpy() for name, tensor in net.state_dict().items()}
    path = tmp_path_factory.mktemp("weights") / "small.safetensors"
    card = {"task": "touch_residual"}
    save_weights(path, Weights(name="small", kind="residual_denoiser", config=config, tensors=tensors, card=card))
    return path


@pytest.fixture
def sampling(open_window, touch_file, weights_file):
    """A bubble's touch as a GelSlim's, eight kept steps."""
    made = open_window(
        touch_file, target="gelslim", frame=2, methods={"touch": "t2d2"}, weights={"touch": weights_file},
        params={KEY: DiffusionParams(steps=8, guidance=2.0, keep_states=True)},
    )  # fmt: skip
    assert wait_until_shown(made, LIMIT_S), made.window.banner.text
    return made


def test_steps_are_shown_in_the_column(sampling):
    window, view = sampling.window, sampling.window.columns["touch"].view
    slider = window.steps["touch"].slider
    assert (slider.maximum(), slider.value()) == (7, 7)
    last = view.preview.pixels
    slider.setValue(0)
    assert not np.array_equal(view.preview.pixels, last)
    slider.setValue(7)
    assert np.array_equal(view.preview.pixels, last)


def test_dragging_a_slider_shows_a_draft_and_releasing_it_the_full_result(sampling):
    window, panel = sampling.window, sampling.window.parameters
    slider = panel.findChild(object, f"{KEY}.guidance").findChild(QSlider)
    slider.sliderPressed.emit()
    slider.setValue(slider.maximum())
    assert wait_until_shown(sampling, LIMIT_S)
    assert sampling.session.params[KEY] == DiffusionParams(steps=8, guidance=15.0, keep_states=True)
    assert not window.steps["touch"].slider.isEnabled(), "a draft keeps no states"
    assert [window.columns[name].state for name in ("touch", "touch_depth")] == ["draft", "draft"]
    assert window.columns["depth"].state == "cached", "what stands above it is as it was"
    draft = window.columns["touch"].view.preview.pixels
    slider.sliderReleased.emit()
    assert wait_until_shown(sampling, LIMIT_S)
    assert window.steps["touch"].slider.maximum() == 7
    assert window.columns["touch"].state in ("computed", "warning")
    assert not np.array_equal(window.columns["touch"].view.preview.pixels, draft)
