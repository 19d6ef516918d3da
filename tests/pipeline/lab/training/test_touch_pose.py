"""Task of pose networks: rotated, mirrored and partial touches, and a network that learns poses."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from pipeline.core.geometry import rigid
from pipeline.lab.training.examples import to_tensors
from pipeline.lab.training.simulated_touches import place_nominal_sensors, simulate_target_touch
from pipeline.lab.training.touch_pose import TouchPoseTask, compute_rotation_loss, flip_touch
from pipeline.physics.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.physics.simulation.press import simulate_press
from pipeline.physics.simulation.shapes import list_labelled_shapes, make_shape
from pipeline.stages.networks.network_factory import build_network
from pipeline.stages.networks.touch_formats import denormalise, normalise, resize_to_square


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return str(tmp_path_factory.mktemp("touches"))


def test_rotations_that_map_an_object_onto_itself_cost_nothing():
    headings = torch.tensor([[[math.cos(n * 0.1), math.sin(n * 0.1)] for n in range(1, 7)]])
    fifth = 2 * math.pi / 5

    def cost(turn, fold):
        return float(compute_rotation_loss(headings, torch.tensor([turn]), torch.tensor([fold])))

    assert cost(0.1 + fifth, 5.0) == pytest.approx(0.0, abs=1e-4)
    assert cost(0.1 + fifth, 1.0) > 1.0
    assert cost(2.0, 0.0) == 0.0
    # a small rotation costs the same for all
    assert cost(0.3, 5.0) == pytest.approx(cost(0.3, 1.0), rel=0.2)


def test_folds_are_those_of_the_catalogue():
    folds = {
        name: make_shape(name).symmetry.fold for name in ("star", "cone", "letters", "ellipse")
    }
    assert folds == {"star": 5, "cone": 0, "letters": 1, "ellipse": 2}


def make_example(name, x, y, turn):
    """Example of an object pressed on the nominal bubble."""
    bubble = place_nominal_sensors(rigid.translation(0.0, 0.0, BUBBLE_DEEPER_MM))[1]
    mesh = make_shape(name).mesh
    pose = rigid.translation(x, y, 0.0) @ rigid.rotation((0.0, 0.0, turn))
    pose[2, 3] = -0.6 - float(mesh.vertices_mm[:, 2].min())
    indentation = simulate_press(mesh, pose, bubble, seed=None).indentation_mm
    one_hot = np.zeros(len(list_labelled_shapes()), np.float32)
    truth = np.array(
        [x, y, turn, make_shape(name).symmetry.fold, list_labelled_shapes().index(name), 1.0],
        np.float32,
    )
    return {
        "square": normalise(resize_to_square(indentation[..., None]), "bubble"),
        "object_one_hot": one_hot,
        "truth": truth,
    }


def test_a_flipped_touch_is_the_touch_of_the_flipped_object():
    here = make_example("edge", 2.0, -3.0, 0.3)
    for way in (1, 2):
        made = flip_touch(here, way)
        x, y, turn = (float(v) for v in made["truth"][:3])
        assert (abs(x), abs(y)) == (2.0, 3.0)
        again = make_example("edge", x, y, turn)
        inner = np.s_[:, 10:108]  # outside, one of the two is beyond the field of view
        gap = np.abs(made["square"] - again["square"])[inner].mean()
        assert gap < 0.01 * np.abs(here["square"] - again["square"])[inner].mean()
    half = flip_touch(here, 3)
    assert np.allclose(half["square"], flip_touch(flip_touch(here, 1), 2)["square"], atol=0.3)
    assert np.allclose(half["truth"][:3], (-2.0, 3.0, 0.3), atol=1e-6)
    letters = {
        **here,
        "truth": np.array(
            [1.0, 1.0, 0.1, 1.0, list_labelled_shapes().index("letters"), 1.0], np.float32
        ),
    }
    assert flip_touch(letters, 1) is letters
    assert flip_touch(letters, 2) is letters, "mirrored letters are another object"


def test_a_partial_touch_is_the_touch_of_the_observed_part(folder):
    touch = simulate_target_touch("soft_bubble", "all_objects", 1, 0, folder)
    less = touch.physical_mm
    whole = touch.target_mm
    assert 0.3 < less.sum() / whole.sum() < 0.98
    deepest = np.unravel_index(int(whole.argmax()), whole.shape)
    assert less[deepest] > 0.6 * whole[deepest]
    task = TouchPoseTask(n_presses=1, folder=folder, partial_share=1.0, augmentation_share=0.0)
    shown = [
        denormalise(task.sample(np.random.default_rng(k))["square"], "bubble").sum()
        for k in range(12)
    ]
    low, high = (float(resize_to_square(mm[..., None]).sum()) for mm in (less, whole))
    assert min(shown) == pytest.approx(low, rel=1e-2)
    assert sum(low * 1.01 < one < high * 0.99 for one in shown) >= 2, (
        "no example mixes part and whole"
    )


@pytest.mark.parametrize("sensor", ["gelslim", "soft_bubble"])
def test_a_pose_network_learns_poses(sensor, folder):
    task = TouchPoseTask(
        sensor=sensor, n_presses=4, folder=folder, partial_share=0.0, name_weight=1.0
    )
    examples = [task.sample(np.random.default_rng(k)) for k in range(8)]
    batch = to_tensors(
        {name: np.stack([one[name] for one in examples]) for name in examples[0]}, "cpu"
    )
    torch.manual_seed(0)
    inputs = 3 if sensor == "gelslim" else 1
    net = build_network(
        "touch_pose",
        {
            "inputs": inputs,
            "n_objects": len(list_labelled_shapes()),
            "base_channels": 8,
            "n_folds": 6,
            "hidden_size": 32,
        },
    ).train()
    optimiser = torch.optim.Adam(net.parameters(), 3e-3)
    before = task.evaluate(net, examples)
    for _ in range(60):
        loss, _ = task.compute_loss(net, batch)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    after = task.evaluate(net, examples)
    assert after["translation error, mm"] < 0.5 * before["translation error, mm"]
    assert after["object accuracy"] == 1.0
    assert net.compute_embedding(batch["square"]).shape == (8, 32)
