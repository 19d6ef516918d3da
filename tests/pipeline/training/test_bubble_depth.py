from dataclasses import replace

import numpy as np
import pytest

from pipeline.networks.network_factory import build_network
from pipeline.stages.depth.bubble_network_input import N_CHANNELS
from pipeline.stages.depth.bubble_network_output import N_OUTPUTS, decode_tensors
from pipeline.training import bubble_noise, bubble_presses
from pipeline.training.bubble_depth import BubbleDepthTask
from pipeline.training.recipe import load_recipe


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    return BubbleDepthTask(n_presses=2, folder=str(tmp_path_factory.mktemp("presses")), side=64)


@pytest.fixture(scope="module")
def pressed(task):
    return bubble_presses.simulate_bubble_press("unseen_tools", 7, 0, task.folder)


def test_an_example_is_the_same_for_the_same_state_whether_its_press_was_kept_or_not(task):
    fresh = replace(task, folder="").sample(np.random.default_rng([1, 2]))
    for _ in range(2):  # the first call keeps the press, the second finds it
        again = task.sample(np.random.default_rng([1, 2]))
        assert all(np.array_equal(fresh[name], again[name]) for name in fresh)
    other = task.sample(np.random.default_rng([1, 3]))
    assert not np.array_equal(fresh["picture"], other["picture"])
    assert fresh["picture"].shape == (N_CHANNELS, 64, 64)
    assert all(array.dtype == np.float32 for array in fresh.values())


def test_a_press_that_was_cut_short_on_the_disk_is_worked_out_again(task, pressed, tmp_path):
    file = next(tmp_path.parent.glob("*/unseen_tools_7_0.npz"))
    file.write_bytes(file.read_bytes()[:1000])
    again = bubble_presses.simulate_bubble_press("unseen_tools", 7, 0, task.folder)
    assert np.array_equal(again.gap_mm, pressed.gap_mm)
    assert file.stat().st_size > 1000


def test_the_object_lies_on_the_membrane_where_it_presses_and_behind_it_elsewhere(pressed):
    assert (pressed.gap_mm >= 0).all()
    assert np.median(pressed.gap_mm[pressed.contact]) < 0.05
    assert pressed.gap_mm[~pressed.contact].mean() > 1.0
    assert pressed.indentation_mm[pressed.contact].min() > 5.0


def test_both_readings_err_and_what_was_lost_is_lost_in_both(pressed):
    rng, unit = np.random.default_rng(0), pressed.sensor
    for _ in range(8):
        rest, now = bubble_noise.simulate_noisy_depth_pair(pressed, rng)
        off = (rest - now) - pressed.indentation_mm
        assert 0.01 < np.nanstd(rest - unit.rest_depth_mm) < 2.0
        assert 0.01 < np.nanstd(off) < 3.0
        assert np.isfinite(off).mean() > 0.4


def test_a_network_comes_nearer_to_two_touches_in_a_few_steps(task):
    import torch

    torch.manual_seed(0)
    batch = {k: torch.tensor(v)[None] for k, v in task.make_validation_example("unseen_tools", 0).items()}
    net = build_network(
        "compact_unet",
        {"inputs": N_CHANNELS, "outputs": N_OUTPUTS, "base_channels": 8, "levels": 3, "max_channels": 16},
    )
    optimiser = torch.optim.Adam(net.parameters(), lr=3e-3)
    losses = []
    for _ in range(12):
        optimiser.zero_grad()
        loss, parts = task.compute_loss(net, batch)
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.85 * losses[0]
    assert set(parts) == {"surface", "membrane", "masks", "spread"}


def test_the_loss_is_least_for_the_truth_and_the_figures_say_so(task):
    import torch

    example = task.make_validation_example("unseen_tools", 0)
    moved, gap, touched = (torch.tensor(a)[None] for a in example["truth"])
    told = gap < 0.5

    class Knows(torch.nn.Module):
        def forward(self, picture):
            logit = [20.0 * (2.0 * mask.float() - 1.0) for mask in (touched, told)]
            behind = torch.log(torch.expm1(torch.clamp(gap, min=1e-3)))  # the inverse of softplus
            return torch.stack([moved - torch.tensor(example["smooth"]), behind, torch.full_like(gap, -6.0), *logit], 1)

    found = task.evaluate(Knows(), [example])
    assert found["contact, IoU"] == found["told, IoU"] == 1.0
    assert found["object's surface off, mm"] < 2e-3
    batch = {k: torch.tensor(v)[None] for k, v in example.items()}
    assert task.compute_loss(Knows(), batch)[1]["surface"] < 1e-3


def test_the_gap_is_never_negative_and_the_spread_stays_in_bounds():
    import torch

    said = decode_tensors(100.0 * torch.randn(2, N_OUTPUTS, 8, 8), torch.zeros(2, 1, 8, 8))
    assert (said.object_displacement_mm <= said.displacement_mm).all()
    assert said.log_error.abs().max() <= 6.0


def test_the_recipe_that_comes_along_fits_the_task():
    recipe = load_recipe("bubble", "depth")
    net = build_network(str(recipe.network["kind"]), {k: v for k, v in recipe.network.items() if k != "kind"})
    assert sum(p.numel() for p in net.parameters()) < 1_050_000
    assert (recipe.network["inputs"], recipe.network["outputs"]) == (N_CHANNELS, N_OUTPUTS)
