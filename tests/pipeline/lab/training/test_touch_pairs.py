"""Simulated pairs as squares, and the tasks that train on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.core.errors import SettingProblem
from pipeline.lab.training import recipe, simulated_touches
from pipeline.lab.training.examples import to_tensors
from pipeline.lab.training.simulated_touches import place_nominal_sensors, simulate_touch_pair
from pipeline.lab.training.square_tasks import VqVaeTask
from pipeline.sensors import alignment
from pipeline.stages.networks.network_factory import build_network
from pipeline.stages.networks.touch_formats import denormalise
from pipeline.stages.touch.image_condition import reproject_square


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return str(tmp_path_factory.mktemp("pairs"))


@pytest.mark.parametrize("damaged", [b"", b"PK\x03\x04", bytes(100)])
def test_a_damaged_file_is_simulated_again(folder, damaged):
    first = simulate_touch_pair("all_objects", 3, 0, folder)
    simulated_touches._pairs.clear()
    (Path(folder) / "pair_all_objects_3_0.npz").write_bytes(damaged)
    again = simulate_touch_pair("all_objects", 3, 0, folder)
    assert np.array_equal(again.change_grey, first.change_grey)
    assert first.bubble_mm.max() > 1.0


@pytest.mark.parametrize(("target", "left"), [("soft_bubble", 0.7), ("gelslim", 0.96)])
def test_a_vqvae_overfits_one_pair(target, left, folder):
    task = VqVaeTask(target=target, n_presses=1, folder=folder)
    batch = to_tensors(
        {k: v[None] for k, v in task.sample(np.random.default_rng(0)).items()}, "cpu"
    )
    torch.manual_seed(0)
    inputs, outputs = (3, 1) if target == "soft_bubble" else (1, 3)
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
    unit = "mm" if target == "soft_bubble" else "grey"
    assert set(figures) == {f"error, {unit}", f"error where touched, {unit}"}


@pytest.mark.parametrize("target", ["soft_bubble", "gelslim"])
def test_reprojected_sources_equal_those_of_the_method(target, folder):
    """Training and use share the squares; a network of the other kind is refused."""
    plain, drawn = (
        VqVaeTask(
            target=target,
            n_presses=1,
            folder=folder,
            reprojects_input=reprojects,
            augmentation_share=0.0,
        )
        for reprojects in (False, True)
    )
    square, example = (task.sample(np.random.default_rng(0))["source"] for task in (plain, drawn))
    pair = simulate_touch_pair("training", 1, 0, folder, bubble_alone=True)
    sensors = place_nominal_sensors(pair.placement)
    source, other = sensors if target == "soft_bubble" else sensors[::-1]
    change = denormalise(square, source.kind)
    expected = reproject_square(change, source, other, alignment.resolve_alignment(source, other))
    assert np.allclose(example, expected, atol=1e-3)
    batch = to_tensors({"source": example[None], "target": example[None]}, "cpu")
    net = build_network(
        "vqvae", {"inputs": len(square), "outputs": 4 - len(square), "width": 4, "codes": 8}
    )
    with pytest.raises(SettingProblem, match="reprojects_input"):
        drawn.compute_loss(net, batch)


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
