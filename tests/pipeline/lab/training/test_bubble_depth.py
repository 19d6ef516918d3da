from dataclasses import replace

import numpy as np
import pytest

from pipeline.lab.training import bubble_depth
from pipeline.lab.training.bubble_depth import BubbleDepthTask
from pipeline.lab.training.recipe import load_recipe
from pipeline.stages.depth.bubble_network_input import N_CHANNELS
from pipeline.stages.depth.bubble_network_output import N_OUTPUTS, decode_tensors
from pipeline.stages.networks.network_factory import build_network


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    return BubbleDepthTask(n_presses=2, folder=str(tmp_path_factory.mktemp("presses")), side=64)


@pytest.fixture(scope="module")
def pressed(task):
    return bubble_depth.simulate_bubble_press("unseen_tools", 7, 0, task.folder)


def test_an_example_is_the_same_whether_its_press_is_stored_or_not(task):
    fresh = replace(task, folder="").sample(np.random.default_rng([1, 2]))
    for _ in range(2):  # the first call stores the press, the second loads it
        bubble_depth._presses.clear()
        again = task.sample(np.random.default_rng([1, 2]))
        assert all(np.array_equal(fresh[name], again[name]) for name in fresh)
    other = task.sample(np.random.default_rng([1, 3]))
    assert not np.array_equal(fresh["image"], other["image"])
    assert fresh["image"].shape == (N_CHANNELS, 64, 64)
    assert all(array.dtype == np.float32 for array in fresh.values())


def test_a_truncated_file_is_simulated_again(task, pressed, tmp_path):
    file = next(tmp_path.parent.glob("*/bubble_unseen_tools_7_0.npz"))
    file.write_bytes(file.read_bytes()[:1000])
    bubble_depth._presses.clear()
    again = bubble_depth.simulate_bubble_press("unseen_tools", 7, 0, task.folder)
    assert np.array_equal(again.gap_mm, pressed.gap_mm)
    assert file.stat().st_size > 1000


def test_the_object_touches_the_membrane_in_contact_and_lies_behind_it_elsewhere(pressed):
    assert (pressed.gap_mm >= 0).all()
    assert np.median(pressed.gap_mm[pressed.contact]) < 0.05
    assert pressed.gap_mm[~pressed.contact].mean() > 1.0
    assert pressed.indentation_mm[pressed.contact].min() > 5.0


def test_both_frames_have_noise_and_share_their_gaps(pressed):
    rng = np.random.default_rng(0)
    sensor = pressed.sensor
    for _ in range(8):
        rest, now = bubble_depth.simulate_noisy_depth_pair(pressed, rng)
        off = (rest - now) - pressed.indentation_mm
        assert 0.01 < np.nanstd(rest - sensor.rest_depth_mm) < 2.0
        assert 0.01 < np.nanstd(off) < 3.0
        assert np.isfinite(off).mean() > 0.4


def test_a_network_learns_a_touch_in_a_few_steps(task):
    import torch

    torch.manual_seed(0)
    batch = {
        k: torch.tensor(v)[None] for k, v in task.make_validation_example("unseen_tools", 0).items()
    }
    net = build_network(
        "compact_unet",
        {
            "inputs": N_CHANNELS,
            "outputs": N_OUTPUTS,
            "base_channels": 8,
            "levels": 3,
            "max_channels": 16,
        },
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
    assert set(parts) == {"surface", "membrane", "masks", "spread", "touch"}


def test_loss_and_metrics_are_best_for_the_truth(task):
    import torch

    example = task.make_validation_example("unseen_tools", 0)
    moved, gap, touched = (torch.tensor(a)[None] for a in example["truth"])
    observed = gap < 0.5

    class Knows(torch.nn.Module):
        def __init__(self, *, fills=False):
            super().__init__()
            self.fills = fills  # says that the membrane touches everywhere

        def forward(self, image):
            logit = [
                20.0 * (2.0 * mask.float() - 1.0)
                for mask in (touched if not self.fills else gap > -1, observed)
            ]
            # the inverse of softplus
            behind = torch.log(torch.expm1(torch.clamp(gap * (not self.fills), min=1e-3)))
            return torch.stack(
                [
                    moved - torch.tensor(example["smooth"]),
                    behind,
                    torch.full_like(gap, -6.0),
                    *logit,
                ],
                1,
            )

    found = task.evaluate(Knows(), [example])
    assert found["contact IoU"] == found["observed object IoU"] == 1.0
    assert found["object surface error, mm"] < 2e-3
    batch = {k: torch.tensor(v)[None] for k, v in example.items()}
    terms, filled = (
        task.compute_loss(network, batch)[1] for network in (Knows(), Knows(fills=True))
    )
    assert terms["surface"] < 1e-3
    assert terms["touch"] < 0.2 * filled["touch"]


def test_the_gap_is_not_negative_and_the_uncertainty_is_bounded():
    import torch

    output = decode_tensors(100.0 * torch.randn(2, N_OUTPUTS, 8, 8), torch.zeros(2, 1, 8, 8))
    assert (output.object_displacement_mm <= output.displacement_mm).all()
    assert output.log_error.abs().max() <= 6.0


def test_the_shipped_recipe_fits_the_task():
    recipe = load_recipe("bubble", "depth")
    net = build_network(
        str(recipe.network["kind"]), {k: v for k, v in recipe.network.items() if k != "kind"}
    )
    assert sum(p.numel() for p in net.parameters()) < 1_050_000
    assert (recipe.network["inputs"], recipe.network["outputs"]) == (N_CHANNELS, N_OUTPUTS)
