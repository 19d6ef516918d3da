"""Training of Depth Anything V2: its examples, and a few steps that lower the paper's loss."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.core.errors import SettingProblem
from pipeline.lab.training import loop, recipe
from pipeline.lab.training.depth_anything import DepthAnythingTask
from pipeline.lab.training.examples import make_batch
from pipeline.stages.networks.network_factory import build_network

TASK = DepthAnythingTask(sensor="digit", side=28)


def test_examples_are_images_of_whole_patches_with_the_truth():
    one, again = (TASK.sample(np.random.default_rng([1, 2])) for _ in range(2))
    other = TASK.sample(np.random.default_rng([1, 3]))
    assert all(np.array_equal(one[name], again[name]) for name in one)
    assert not np.array_equal(one["image"], other["image"])
    rows, cols = one["indentation_mm"].shape
    assert (min(rows, cols), rows % 14, cols % 14) == (28, 0, 0)
    assert one["image"].shape == (3, rows, cols)
    assert 0.0 <= one["image"].min() < one["image"].max() <= 1.001
    pressed = one["contact"] > 0.5
    assert pressed.any()
    assert one["indentation_mm"][pressed].mean() > one["indentation_mm"][~pressed].mean()


def test_a_few_steps_lower_the_loss_and_change_the_encoder_less_than_the_head():
    made = recipe.load_recipe("depth_anything")
    torch.manual_seed(0)
    net = build_network("depth_anything", {"encoder": "vits", "side": 28})
    start = {name: tensor.clone() for name, tensor in net.state_dict().items()}
    batch = {name: torch.from_numpy(array) for name, array in make_batch(TASK, 0, 0, 2).items()}
    stepper = loop.make_optimiser(net, made.optimiser, made.rate_factors)
    loop.set_learning_rate(stepper, 2e-4)
    losses = []
    for _ in range(5):
        stepper.zero_grad()
        loss, parts = TASK.compute_loss(net, batch)
        loss.backward()
        stepper.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.9 * losses[0]
    assert set(parts) == {"silog", "contact"}
    moved = {name: float((t - start[name]).abs().max()) for name, t in net.state_dict().items()}
    head = max(size for name, size in moved.items() if name.startswith("depth_head."))
    encoder = max(size for name, size in moved.items() if name.startswith("pretrained."))
    assert 0 < encoder < 0.3 * head
    figures = TASK.evaluate(
        net.eval().requires_grad_(requires_grad=False),
        [TASK.make_validation_example("unseen_tools", 0)],
    )
    assert all(np.isfinite(value) for value in figures.values())


def test_a_network_of_distances_is_refused():
    task = DepthAnythingTask(sensor="digit", side=28)
    batch = {name: torch.from_numpy(array) for name, array in make_batch(task, 0, 0, 1).items()}
    net = build_network("depth_anything", {"encoder": "vits", "side": 28, "answer": "distance"})
    with pytest.raises(SettingProblem, match="answer"):
        task.compute_loss(net, batch)
