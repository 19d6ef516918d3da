"""Sliders of a diffusion method: drafts while dragged, full results when released, kept steps."""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np
import pytest
from PyQt6.QtCore import QCoreApplication
from PyQt6.QtWidgets import QLabel, QSlider, QSpinBox

from app.shell.tour import wait_until_shown
from pipeline.core.graph import Graph
from pipeline.stages.networks.weights import Weights, save_weights
from pipeline.stages.touch.t2d2 import CONDITION_CHANNELS, T2D2Params
from tests.app.window.window_checks import find_control
from widgets.shell.command_palette import CommandPalette

LIMIT_S = 240
KEY = "touch/t2d2"


@pytest.fixture(scope="module")
def weights_file(tmp_path_factory):
    """Weights of a small untrained network."""
    import torch

    from pipeline.stages.networks.network_factory import build_network

    config = {
        "inputs": CONDITION_CHANNELS,
        "unit_mm": 0.2,
        "base_channels": 4,
        "levels": 2,
        "max_channels": 8,
    }
    torch.manual_seed(0)
    net = build_network("residual_denoiser", config)
    torch.nn.init.normal_(net.finish.weight, std=0.1)
    tensors = {name: tensor.float().numpy() for name, tensor in net.state_dict().items()}
    path = tmp_path_factory.mktemp("weights") / "small.safetensors"
    card = {"task": "touch_residual"}
    save_weights(
        path,
        Weights(name="small", kind="residual_denoiser", config=config, tensors=tensors, card=card),
    )
    return path


@pytest.fixture
def sampling(open_window, touch_file, weights_file):
    """A bubble's touch as a GelSlim's, eight kept steps."""
    made = open_window(
        touch_file,
        target="gelslim",
        frame=2,
        methods={"touch": "t2d2"},
        weights={"touch": weights_file},
        params={KEY: T2D2Params(steps=8, guidance=2.0, keep_states=True)},
    )
    assert wait_until_shown(made, LIMIT_S), made.window.banner.text
    return made


def test_steps_are_shown_in_the_column(sampling):
    window = sampling.window
    view = sampling.window.columns["touch"].view
    panel = window.steps_panel
    window.actions_by_name["step_through"].trigger()
    panel.stage_box.setCurrentIndex(panel.stage_box.findData("touch"))
    panel.stage_box.chosen.emit("touch")
    assert (panel.plot.n_steps, panel.plot.current_step) == (8, 7)
    last = view.preview.pixels
    panel.plot.step_chosen.emit(0)
    assert panel.plot.current_step == 0
    assert not np.array_equal(view.preview.pixels, last)
    panel.plot.step_chosen.emit(7)
    assert np.array_equal(view.preview.pixels, last)


def test_dragging_a_slider_shows_a_draft_and_releasing_it_the_full_result(sampling):
    window = sampling.window
    panel = sampling.window.parameters
    slider = panel.findChild(object, f"{KEY}.guidance").findChild(QSlider)
    slider.sliderPressed.emit()
    slider.setValue(slider.maximum())
    assert wait_until_shown(sampling, LIMIT_S)
    assert sampling.session.params[KEY] == T2D2Params(steps=8, guidance=15.0, keep_states=True)
    steps = sampling.views.get_shown_stage("touch").result.output.steps
    assert not steps, "a draft keeps no states"
    assert [window.columns[name].state for name in ("touch", "touch_depth")] == ["draft", "draft"]
    assert window.columns["depth"].state == "cached", "what stands above it is as it was"
    draft = window.columns["touch"].view.preview.pixels
    slider.sliderReleased.emit()
    assert wait_until_shown(sampling, LIMIT_S)
    assert len(sampling.views.get_shown_stage("touch").result.output.steps) == 8
    assert window.columns["touch"].state in ("computed", "warning")
    assert not np.array_equal(window.columns["touch"].view.preview.pixels, draft)


def test_steps_guidance_and_seed_stay_in_sight_whatever_stage_is_chosen(sampling, qtbot):
    window = sampling.window
    window.resize(1600, 950)
    for stage in ("depth", "pose", "touch"):
        window.actions_by_name[f"stage_{[*window.columns].index(stage) + 1}"].trigger()
        assert wait_until_shown(sampling, LIMIT_S)
        for name in ("steps", "guidance", "seed"):
            qtbot.waitUntil(find_control(sampling, name).isVisible, timeout=240_000)
    column = window.columns["touch"]
    assert column.findChild(QLabel, "note_touch").text().startswith("network correction: ")
    sampling.choose_params(KEY, T2D2Params())
    find_control(sampling, "guidance").findChild(QSlider).setValue(200)
    assert sampling.session.params[KEY].steps == 8
    assert "raised to 8" in window.said
    assert find_control(sampling, "steps").findChild(QSpinBox).value() == 8
    assert wait_until_shown(sampling, LIMIT_S)


def test_what_cannot_act_is_grey_with_the_reason(sampling):
    sampling.change("choose", methods={"touch": "t2d2"}, weights={}, target="digit")
    assert wait_until_shown(sampling, LIMIT_S)
    column = sampling.window.columns["touch"]
    assert (column.findChild(QLabel, "note_touch").text(), column.state) == (
        "physics: no network for this pair",
        "warning",
    )
    assert not find_control(sampling, "steps").isEnabled()
    assert "from a bubble to a gel" in find_control(sampling, "steps").toolTip()


def test_a_parameter_is_found_by_its_name(sampling, qtbot):
    window = sampling.window
    window.actions_by_name["palette"].trigger()
    palette = window.findChild(CommandPalette)
    palette.line.setText("guid")
    assert "Guidance scale" in palette.results.currentItem().text()
    palette.run_selected()
    qtbot.waitUntil(lambda: window.inspector.isAncestorOf(window.focusWidget()))


def test_a_draft_is_shown_before_the_next_one_starts(sampling, monkeypatch):
    """A drag shows drafts although the value changes three times while each is computed."""
    evaluate = Graph.evaluate
    shown = []
    n_changes = 0

    def evaluate_for_three_changes(self, wanted, inputs, params, progress, on_stage):
        wanted_changes = n_changes + 3
        end_s = time.monotonic() + LIMIT_S
        while n_changes < wanted_changes and dragging and time.monotonic() < end_s:
            time.sleep(0.001)
        return evaluate(self, wanted, inputs, params, progress, on_stage)

    def count_drafts() -> int:
        return sum(result.draft and result.name == "touch" for result in shown)

    monkeypatch.setattr(Graph, "evaluate", evaluate_for_three_changes)
    show = sampling.views.show_stage
    monkeypatch.setattr(
        sampling.views,
        "show_stage",
        lambda part, **how: (
            (shown.append(part.result), show(part, **how))
            if hasattr(part, "result")
            else show(part, **how)
        ),
    )
    slider = find_control(sampling, "guidance").findChild(QSlider)
    dragging = True
    end_s = time.monotonic() + LIMIT_S
    slider.sliderPressed.emit()
    while count_drafts() < 3 and time.monotonic() < end_s:
        n_changes += 1
        slider.setValue(100 + n_changes % 200)
        QCoreApplication.processEvents()
        time.sleep(0.005)
    dragging = False
    slider.sliderReleased.emit()
    assert wait_until_shown(sampling, LIMIT_S)
    assert count_drafts() >= 3
    assert not sampling.latest_frame.results["touch"].draft


def test_a_drag_on_a_busy_machine_shows_drafts(sampling):
    """A slider that never rests does not starve its drafts, whatever else runs."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(4)]
    shown = []
    show = sampling.views.show_stage

    def count(part, **how) -> None:
        show(part, **how)
        result = getattr(part, "result", None)
        if result is not None and result.name == "touch" and result.draft:
            shown.append(sampling.window.columns["touch"].view.preview)

    sampling.views.show_stage = count
    slider = find_control(sampling, "guidance").findChild(QSlider)
    try:
        slider.sliderPressed.emit()
        end_s = time.monotonic() + LIMIT_S
        at = 0
        while not shown and time.monotonic() < end_s:
            at += 1
            slider.setValue(100 + at % 200)
            QCoreApplication.processEvents()
            time.sleep(0.005)
    finally:
        for process in busy:
            process.kill()
            process.wait()
    assert shown, "no draft while the slider moved"
    slider.sliderReleased.emit()
    assert wait_until_shown(sampling, LIMIT_S)
