"""Training data of the compact diffusion: touches of the target for T2D2, pairs for T2T."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.core.arrays import freeze
from pipeline.core.geometry import rigid
from pipeline.lab.training import denoising, simulated_touches
from pipeline.lab.training.denoising import TouchResidualTask, TouchToTouchTask
from pipeline.lab.training.recipe import list_shipped_recipes, load_recipe
from pipeline.lab.training.simulated_touches import simulate_target_touch
from pipeline.physics.simulation import shapes
from pipeline.stages.networks.network_factory import build_network
from pipeline.stages.networks.touch_formats import BUBBLE, GEL
from pipeline.stages.touch.t2d2 import CONDITION_CHANNELS

SPLITS = ("unseen_grasps", "unseen_tools")
MIRROR_MM = 0.02  # difference between an object and its mirror on a lattice
NOISE_GREY = 3.0  # two images of one surface, each with noise


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return str(tmp_path_factory.mktemp("touches"))


@pytest.fixture(scope="module")
def task(folder):
    return TouchResidualTask(target="gelslim", n_presses=2, folder=folder)


def test_recipes_of_touch_to_depth_to_touch_use_no_pairs(monkeypatch):
    pressed = []

    def press(mesh, pose, sensor, **how):
        pressed.append(sensor.name)
        raise StopIteration

    monkeypatch.setattr(simulated_touches, "simulate_press", press)
    names = list_shipped_recipes("t2d2")
    assert len(names) >= 2
    for name in names:
        task = load_recipe(name, "t2d2").settings
        for make in (
            lambda t: t.sample(np.random.default_rng(1)),
            lambda t: t.make_validation_example(SPLITS[0], 987_654),
        ):
            pressed.clear()
            with pytest.raises(StopIteration):
                make(replace(task, folder="", press_seed=987_654))
            assert pressed == [task.target], "a second sensor is pressed"


def test_a_stored_touch_equals_the_simulated_one(folder):
    first = simulate_target_touch("gelslim", "unseen_tools", 7, 1, folder)
    for again in range(2):
        simulated_touches._touches.clear()
        found = simulate_target_touch("gelslim", "unseen_tools", 7, 1, folder if again else "")
        for name in (
            "observed_mm",
            "observed",
            "in_view",
            "physical_mm",
            "physical_contact",
            "target_mm",
            "target_contact",
        ):
            assert np.array_equal(getattr(first, name), getattr(found, name)), name


def test_physics_plus_residual_is_the_target(task):
    touches = {
        index: simulate_target_touch("gelslim", "unseen_tools", 7, index, task.folder)
        for index in range(4)
    }
    observed = {index: touch for index, touch in touches.items() if touch is not None}
    assert observed
    for index, touch in observed.items():
        example = task.make_validation_example("unseen_tools", index)
        assert example["condition"].shape == (CONDITION_CHANNELS, *touch.target_contact.shape)
        whole = touch.physical_mm + GEL.residual_unit_mm * example["residual"][0]
        assert np.allclose(whole, touch.target_mm, atol=1e-4)
        change = touch.physical_contact.astype(float) + example["residual"][1]
        assert np.array_equal(change > 0.5, touch.target_contact)
        assert touch.observed[~touch.in_view].sum() == 0


def test_an_example_depends_on_its_seed_alone(task):
    a, b = (task.sample(np.random.default_rng([1, 5])) for _ in range(2))
    assert all(np.array_equal(a[name], b[name]) for name in a)
    assert {name: array.dtype for name, array in a.items()} == dict.fromkeys(
        a, np.dtype(np.float32)
    )


def test_a_network_learns_a_touch_and_its_metrics_start_at_the_baseline(task):
    import torch

    example = task.make_validation_example("unseen_tools", 0)
    batch = {k: torch.tensor(v)[None].repeat(4, 1, 1, 1) for k, v in example.items()}
    config = {
        "inputs": CONDITION_CHANNELS,
        "unit_mm": 0.2,
        "base_channels": 8,
        "levels": 2,
        "max_channels": 16,
    }
    torch.manual_seed(0)
    net = build_network("residual_denoiser", config)
    before = task.evaluate(net.eval(), [example])
    for what in ("error in contact, mm", "error over all, mm", "contact IoU"):
        assert before[what] == pytest.approx(before[f"no-prediction {what}"])
    optimiser = torch.optim.Adam(net.train().parameters(), lr=5e-3)
    losses = []
    for _ in range(25):
        optimiser.zero_grad()
        loss, parts = task.compute_loss(net, batch)
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert np.mean(losses[-5:]) < 0.8 * np.mean(losses[:5])
    assert set(parts) == {"residual", "contact", "spread"}


def test_a_pair_gives_the_source_change_and_the_target_touch(folder):
    task = TouchToTouchTask(n_presses=2, folder=folder)
    example = task.make_validation_example("unseen_tools", 0)
    pair = simulated_touches.simulate_touch_pair("unseen_tools", 7, 0, folder)
    assert example["condition"].shape == (14, *pair.bubble_mm.shape)
    assert np.allclose(BUBBLE.residual_unit_mm * example["residual"][0], pair.bubble_mm, atol=1e-4)
    assert not example["contact"][1].any()
    assert load_recipe("t2t_bubble", "t2t").network["inputs"] == 14


def test_a_mirrored_pair_is_that_of_the_mirrored_object(monkeypatch):
    """Nominal sensors, so that only the mirroring differs; along both axes at once."""
    over = np.diag([-1.0, -1.0, 1.0])
    monkeypatch.setattr(
        simulated_touches.variation, "vary_sensor", lambda sensor, seed, strength=1.0: sensor
    )
    mesh = shapes.make_shape("letters").mesh
    pose = rigid.translation(1.0, -2.0, -0.6)
    monkeypatch.setattr(simulated_touches, "sample_object", lambda *_, **__: ("", mesh))
    monkeypatch.setattr(simulated_touches.poses, "sample_press_pose", lambda *_, **__: pose)
    pair = simulated_touches._simulate_pair("unseen_tools", np.random.default_rng(0), 0, "gelslim")
    turned = replace(mesh, vertices_mm=freeze(rigid.apply(pose, mesh.vertices_mm) @ over))
    monkeypatch.setattr(simulated_touches, "sample_object", lambda *_, **__: ("", turned))
    monkeypatch.setattr(simulated_touches.poses, "sample_press_pose", lambda *_, **__: np.eye(4))
    true = simulated_touches._simulate_pair("unseen_tools", np.random.default_rng(0), 0, "gelslim")

    class Both:
        """A generator that asks for both mirrors."""

        def integers(self, high):
            return 3 if high == 4 else 0

    found = simulated_touches.mirror_pair(pair, Both())
    assert pair.gel_contact.any()
    assert np.abs(true.bubble_mm - pair.bubble_mm).max() > 1.0, (
        "the touch is symmetric: the test shows nothing"
    )
    assert np.abs(found.bubble_mm - true.bubble_mm).max() < MIRROR_MM
    assert np.abs(found.gel_mm - true.gel_mm).max() < MIRROR_MM
    assert np.abs(found.change_grey - true.change_grey).mean() < NOISE_GREY
    assert (found.bubble_contact != true.bubble_contact).mean() < 0.01


def test_uncertainty_alone_is_trained_on_the_error(task):
    """With all but the last layer frozen, as in recipes, the predicted touch stays and its
    predicted error changes.
    """
    example = task.make_validation_example("unseen_tools", 2)
    batch = {name: torch.from_numpy(np.stack([a, a])) for name, a in example.items()}
    net = build_network(
        "residual_denoiser",
        {
            "inputs": CONDITION_CHANNELS,
            "unit_mm": 0.2,
            "base_channels": 8,
            "levels": 2,
            "max_channels": 8,
        },
    )
    alone = replace(task, uncertainty_only=True)
    sigma = torch.full((2,), net.sigma_max)
    none = torch.zeros(2, 2, *example["residual"].shape[1:])
    with torch.no_grad():
        before = net.eval()(none, sigma, batch["condition"])
    optimiser = torch.optim.Adam(net.finish.parameters(), lr=3e-2)
    losses = []
    for _ in range(60):
        optimiser.zero_grad()
        loss, _parts = alone.compute_loss(net.train(), batch)
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    with torch.no_grad():
        after = net.eval()(none, sigma, batch["condition"])
    assert torch.equal(before[:, :2], after[:, :2])
    assert losses[-1] < losses[0] - 0.1
    off = (after[:, 0] - batch["residual"][:, 0]).abs()
    assert after[:, 2][off > 0.5].mean() > after[:, 2][off < 0.05].mean(), (
        "the predicted error does not grow with the error"
    )


def test_the_slope_term_counts_differences_between_pixels():
    """A constant error has no slopes, an alternating one of the same size has."""
    net = build_network(
        "residual_denoiser",
        {
            "inputs": CONDITION_CHANNELS,
            "unit_mm": 0.2,
            "base_channels": 8,
            "levels": 2,
            "max_channels": 8,
        },
    )
    even = torch.full((1, 2, 16, 16), 0.1)
    uneven = torch.full((1, 2, 16, 16), 0.1)
    uneven[..., ::2] *= -1.0
    for clean, costs in ((even, 0.0), (uneven, 0.2**2)):
        batch = {
            "condition": torch.zeros(1, CONDITION_CHANNELS, 16, 16),
            "residual": clean,
            "contact": torch.zeros(1, 2, 16, 16),
        }
        totals = []
        for slopes in (0.0, 10.0):
            torch.manual_seed(0)
            totals.append(float(denoising.compute_denoising_loss(net, batch, slopes)[0].detach()))
        assert totals[1] - totals[0] == pytest.approx(10.0 * costs, abs=1e-5), (
            "a new network predicts nothing"
        )
