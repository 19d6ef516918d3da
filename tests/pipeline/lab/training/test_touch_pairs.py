"""Simulated pairs as squares, and the tasks that train on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.core.errors import SettingProblem
from pipeline.lab.training import recipe, touch_squares
from pipeline.lab.training.loop import to_tensors
from pipeline.lab.training.touch_squares import simulate_touch_squares
from pipeline.lab.training.vqvae import VqVaeTask
from pipeline.physics.simulation.shapes import list_labelled_shapes
from pipeline.sensors import alignment
from pipeline.stages.networks.network_factory import build_network
from pipeline.stages.touch.image_condition import reproject_square


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return str(tmp_path_factory.mktemp("pairs"))


def test_a_stored_touch_equals_the_simulated_one(folder):
    pressed = simulate_touch_squares("all_objects", 3, 0)
    for _ in range(2):  # simulated and stored, then loaded
        touch_squares._touches.clear()
        touch = simulate_touch_squares("all_objects", 3, 0, folder)
        assert all(
            np.array_equal(getattr(touch, name), getattr(pressed, name))
            for name in (
                "gel_change",
                "nominal_gel_change",
                "bubble_imprint_mm",
                "exact_imprint_mm",
                "alignment_from_object",
            )
        )
    assert pressed.object_name in list_labelled_shapes()
    assert pressed.gel_change.shape == (3, 128, 128)
    assert pressed.exact_imprint_mm.max() > 1.0


@pytest.mark.parametrize("damaged", [b"", b"PK\x03\x04", bytes(100)])
def test_a_damaged_file_is_simulated_again(folder, damaged):
    first = simulate_touch_squares("all_objects", 3, 0, folder)
    touch_squares._touches.clear()
    (file,) = (p for p in Path(folder).iterdir() if p.name == "squares_all_objects_3_0.npz")
    file.write_bytes(damaged)
    assert np.array_equal(
        simulate_touch_squares("all_objects", 3, 0, folder).gel_change, first.gel_change
    )


def test_nominal_and_other_gel_show_the_same_touch(folder):
    """Both images change at the same places, under other light and markers."""
    touch = simulate_touch_squares("all_objects", 3, 0, folder)
    a, b = (
        np.abs(change).sum(0).ravel() for change in (touch.gel_change, touch.nominal_gel_change)
    )
    assert not np.array_equal(touch.gel_change, touch.nominal_gel_change)
    assert np.corrcoef(a, b)[0, 1] > 0.6


@pytest.mark.parametrize(("direction", "left"), [("gel_to_bubble", 0.7), ("bubble_to_gel", 0.96)])
def test_a_vqvae_overfits_one_pair(direction, left, folder):
    task = VqVaeTask(direction=direction, n_presses=1, folder=folder)
    batch = to_tensors(
        {k: v[None] for k, v in task.sample(np.random.default_rng(0)).items()}, "cpu"
    )
    torch.manual_seed(0)
    inputs, outputs = (3, 1) if direction == "gel_to_bubble" else (1, 3)
    net = build_network(
        "vqvae", {"inputs": inputs, "outputs": outputs, "width": 12, "codes": 64}
    ).train()
    optimiser = torch.optim.Adam(net.parameters(), 5e-3)
    losses = []
    for _ in range(30):
        loss, parts = task.compute_loss(net, batch)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(parts["reconstruction"]))
    assert losses[-1] < left * losses[0]
    figures = task.evaluate(net.eval(), [{k: v[0].numpy() for k, v in batch.items()}])
    unit = "mm" if direction == "gel_to_bubble" else "grey"
    assert set(figures) == {f"error, {unit}", f"error where touched, {unit}"}


@pytest.mark.parametrize("direction", ["gel_to_bubble", "bubble_to_gel"])
def test_reprojected_sources_equal_those_of_the_method(direction, folder):
    """Training and use share the squares; a network of the other kind is refused."""
    task = VqVaeTask(direction=direction, n_presses=1, folder=folder, reprojects_input=True)
    touch, (gel, bubble) = (
        simulate_touch_squares("training", 1, 0, folder),
        touch_squares.load_nominal_sensors(),
    )
    source, target = (gel, bubble) if direction == "gel_to_bubble" else (bubble, gel)
    square = touch.gel_change if direction == "gel_to_bubble" else touch.bubble_imprint_mm
    example = task.sample(np.random.default_rng(0))
    assert np.array_equal(
        example["source"],
        reproject_square(square, source, target, alignment.resolve_alignment(source, target)),
    )
    batch = to_tensors({name: np.stack([array]) for name, array in example.items()}, "cpu")
    net = build_network(
        "vqvae", {"inputs": len(square), "outputs": 4 - len(square), "width": 4, "codes": 8}
    )
    with pytest.raises(SettingProblem, match="reprojects_input"):
        task.compute_loss(net, batch)


def test_source_and_target_are_mirrored_together(folder):
    plain = VqVaeTask(n_presses=1, folder=folder).sample(np.random.default_rng(0))
    seen = set()
    for seed in range(40):
        made = VqVaeTask(n_presses=1, folder=folder, mirror_share=1.0).sample(
            np.random.default_rng(seed)
        )
        flips = [
            axes
            for axes in ((), (-1,), (-2,), (-1, -2))
            if np.array_equal(np.flip(plain["source"], axes), made["source"])
        ]
        assert len(flips) == 1
        assert np.array_equal(np.flip(plain["target"], flips[0]), made["target"])
        seen.add(flips[0])
    assert len(seen) == 4


@pytest.mark.parametrize(
    "name",
    [
        "vqvae",
        "vqvae_gel",
        "pose",
        "pose_gel",
        "latent",
        "latent_t2d2",
        "latent_gelslim",
        "latent_t2d2_gelslim",
        "latent_autoencoder",
    ],
)
def test_shipped_recipes_build_their_networks(name):
    made = recipe.load_recipe(name)
    arguments = {key: value for key, value in made.network.items() if key != "kind"}
    net = build_network(str(made.network["kind"]), arguments)
    assert sum(p.numel() for p in net.parameters()) * 2 < 16 * 2**20
