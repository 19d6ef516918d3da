"""Squares that latent diffusion is trained on equal those in use, and its task learns one touch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.core.errors import SettingProblem
from pipeline.lab.training import simulated_touches, square_tasks
from pipeline.lab.training.examples import to_tensors
from pipeline.lab.training.simulated_touches import simulate_touch_pair
from pipeline.lab.training.square_tasks import LatentTask
from pipeline.physics.simulation.press import move_bubble_closer
from pipeline.sensors.alignment import resolve_alignment
from pipeline.sensors.spec import load_sensor
from pipeline.stages.networks.network_factory import build_network
from pipeline.stages.networks.touch_formats import BUBBLE
from pipeline.stages.networks.weights import Weights, save_weights
from pipeline.stages.touch.image_condition import build_reprojected_square

SMALL = {
    "side": 32,
    "width": 8,
    "channel_multipliers": "1 2",
    "blocks": 1,
    "attention": "2",
    "heads": 2,
    "groups": 4,
    "autoencoder_width": 8,
    "autoencoder_multipliers": "1 1 2 2",
    "autoencoder_blocks": 1,
    "condition_channels": 4,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return str(tmp_path_factory.mktemp("touches"))


def make_batch(task, n=2):
    examples = [task.sample(np.random.default_rng(k)) for k in range(n)]
    return to_tensors(
        {name: np.stack([one[name] for one in examples]) for name in examples[0]}, "cpu"
    )


def make_network(condition, inputs=3):
    torch.manual_seed(0)
    encoder = "fold" if condition == "depth" else "resnet"
    config = {
        **SMALL,
        "condition": condition,
        "condition_inputs": inputs,
        "condition_encoder": encoder,
    }
    return build_network("latent", config).train()


@pytest.mark.parametrize(
    ("target", "condition", "inputs"), [("soft_bubble", "reprojected", 5), ("gelslim", "depth", 3)]
)
def test_latent_diffusion_overfits_one_touch(target, condition, inputs, folder):
    task = LatentTask(
        target=target,
        condition=condition,
        n_presses=1,
        folder=folder,
        side=32,
        reconstruction_weight=16,
    )
    batch = make_batch(task)
    assert batch["target"].shape == (2, 3, 32, 32)
    assert batch["source"].shape == (2, inputs, 32, 32)
    net = make_network(condition, inputs)
    optimiser = torch.optim.Adam(net.parameters(), 3e-3)
    losses = []
    for _ in range(40):
        torch.manual_seed(1)  # the same noise and times in every step
        loss, parts = task.compute_loss(net, batch)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append((float(parts["noise"]), float(parts["reconstruction"])))
    assert losses[-1][0] < 0.9 * losses[0][0]
    assert losses[-1][1] < 0.6 * losses[0][1]
    figures = task.evaluate(net.eval(), [task.make_validation_example("unseen_grasps", 0)])
    assert set(figures) == {
        f"reconstruction error, {'mm' if target == 'soft_bubble' else 'grey'}",
        "noise error",
    }


def test_targets_encoded_once_are_the_latents_of_every_step(folder, tmp_path):
    """A denoiser is trained on the same noisy latents, whoever encodes the image."""
    net = make_network("depth").eval()
    file = tmp_path / "autoencoder.safetensors"
    tensors = {name: tensor.numpy() for name, tensor in net.state_dict().items()}
    save_weights(
        file,
        Weights(
            name="a",
            kind="latent",
            config={**SMALL, "condition_encoder": "fold"},
            tensors=tensors,
            card={"task": "latent"},
        ),
    )
    task = LatentTask(target="gelslim", condition="depth", n_presses=1, folder=folder, side=32)
    plain = make_batch(task)
    encoded = make_batch(replace(task, autoencoder=str(file)))
    assert encoded["target"].shape == (2, 8, 4, 4)
    given = {
        "source": plain["source"],
        "time": torch.tensor([9, 700]),
        "has_condition": torch.ones(2),
    }
    noises = torch.randn(2, 2, 4, 4, 4)
    with torch.no_grad():
        outputs = [
            net(batch["target"], **given, noises=noises, part="denoiser")
            for batch in (plain, encoded)
        ]
    assert torch.allclose(outputs[0].mean, outputs[1].mean, atol=1e-5)
    assert torch.allclose(outputs[0].predicted_noise, outputs[1].predicted_noise, atol=1e-5)


def test_a_network_of_another_condition_is_refused(folder):
    task = LatentTask(target="gelslim", condition="depth", n_presses=1, folder=folder, side=32)
    with pytest.raises(SettingProblem, match="condition"):
        task.compute_loss(make_network("image"), make_batch(task))


def test_a_touch_from_depth_needs_no_pair(folder, monkeypatch):
    monkeypatch.setattr(
        square_tasks,
        "simulate_touch_pair",
        lambda *_, **__: pytest.fail("a pair was simulated"),
    )
    example = LatentTask(
        target="gelslim", condition="depth", n_presses=1, folder=folder, side=32
    ).sample(np.random.default_rng(0))
    assert example["source"].shape == (3, 32, 32)


def test_a_bubbles_surface_is_measured_from_the_gels_at_rest():
    """A bubble 2 mm closer to the object has the same imprint 2 mm lower.

    1 mm more imprint is 1 mm higher.
    """
    gel = load_sensor("gelslim")
    bubble = load_sensor("soft_bubble")

    def measure_height(closer_mm, imprint_mm):
        moved = move_bubble_closer(bubble, closer_mm)
        square = np.full((1, 64, 64), imprint_mm, np.float32)
        made = build_reprojected_square(square, moved, gel, resolve_alignment(moved, gel))
        assert made.shape == (BUBBLE.reprojected_channels, 64, 64)
        return made[0, 28:36, 28:36]

    first = measure_height(0.0, 4.0)
    assert np.abs(first).max() < 1.0  # the bubble reaches 4 mm beyond the gel
    assert np.allclose(measure_height(0.0, 5.0) - first, 1.0, atol=1e-3)
    assert np.allclose(measure_height(2.0, 6.0) - first, 0.0, atol=0.1)


def test_training_pairs_may_touch_the_bubble_alone(folder, monkeypatch):
    monkeypatch.setattr(simulated_touches, "_PLACED_AS_RECORDED_SHARE", 1.0)
    monkeypatch.setattr(simulated_touches, "_ABOVE_SHARE", 1.0)
    monkeypatch.setattr(simulated_touches, "_ABOVE_MM", (-0.2, -0.1))
    found = [simulate_touch_pair("training", 6, k, folder, bubble_alone=True) for k in range(3)]
    assert all(pair.bubble_contact.any() and not pair.gel_contact.any() for pair in found)
    assert all(simulate_touch_pair("training", 6, k, folder) is None for k in range(3))
