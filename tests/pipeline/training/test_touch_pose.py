"""The task of pose networks: a touch turned and mirrored, in part, and a network that learns where things are."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from pipeline.geometry import rigid
from pipeline.networks.building import build
from pipeline.networks.squares import measured, normal, square
from pipeline.simulation.press import press
from pipeline.simulation.shapes import shape, taught
from pipeline.training import paired_touches
from pipeline.training.loop import tensors
from pipeline.training.paired_touches import paired_touch
from pipeline.training.part_touches import part
from pipeline.training.touch_pose import TouchPoseTask, turn_cost, turned


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return str(tmp_path_factory.mktemp("touches"))


def test_turns_that_map_an_object_onto_itself_cost_nothing():
    headings = torch.tensor([[[math.cos(n * 0.1), math.sin(n * 0.1)] for n in range(1, 7)]])
    fifth = 2 * math.pi / 5
    cost = lambda turn, fold: float(turn_cost(headings, torch.tensor([turn]), torch.tensor([fold])))  # noqa: E731
    assert cost(0.1 + fifth, 5.0) == pytest.approx(0.0, abs=1e-4)
    assert cost(0.1 + fifth, 1.0) > 1.0
    assert cost(2.0, 0.0) == 0.0
    assert cost(0.3, 5.0) == pytest.approx(cost(0.3, 1.0), rel=0.2)  # a small turn costs the same for all


def test_folds_are_those_of_the_catalogue():
    folds = {name: shape(name).symmetry.fold for name in ("star", "cone", "letters", "ellipse")}
    assert folds == {"star": 5, "cone": 0, "letters": 1, "ellipse": 2}


def imprint(name, x, y, turn):
    """What the described bubble feels of an object that stands so, as an example."""
    bubble, mesh = paired_touches.described()[1], shape(name).mesh
    pose = rigid.translation(x, y, 0.0) @ rigid.rotation((0.0, 0.0, turn))
    pose[2, 3] = -0.6 - float(mesh.vertices_mm[:, 2].min())
    felt = press(mesh, pose, bubble, seed=None).truth.indentation_mm
    known = np.zeros(len(taught()), np.float32)
    truth = np.array([x, y, turn, shape(name).symmetry.fold, taught().index(name), 1.0], np.float32)
    return {"square": normal(square(felt[..., None]), "bubble"), "known": known, "truth": truth}


def test_a_turned_touch_is_the_touch_of_what_was_turned():
    here = imprint("edge", 2.0, -3.0, 0.3)
    for way in (1, 2):
        made = turned(here, way)
        x, y, turn = (float(v) for v in made["truth"][:3])
        assert (abs(x), abs(y)) == (2.0, 3.0)
        again = imprint("edge", x, y, turn)
        seen = np.s_[:, 10:108]  # beyond, the camera did not see what is seen now
        gap = np.abs(made["square"] - again["square"])[seen].mean()
        assert gap < 0.01 * np.abs(here["square"] - again["square"])[seen].mean()
    half = turned(here, 3)
    assert np.allclose(half["square"], turned(turned(here, 1), 2)["square"], atol=0.3)
    assert np.allclose(half["truth"][:3], (-2.0, 3.0, 0.3), atol=1e-6)
    letters = {**here, "truth": np.array([1.0, 1.0, 0.1, 1.0, taught().index("letters"), 1.0], np.float32)}
    assert turned(letters, 1) is letters
    assert turned(letters, 2) is letters, "an R mirrored is no R"


def test_a_part_is_the_touch_without_what_was_not_told(folder):
    whole, less = paired_touch("own", 1, 0, folder).exact_mm, part("own", 1, 0, folder).imprint_mm
    assert 0.3 < less.sum() / whole.sum() < 0.98
    deepest = np.unravel_index(int(whole.argmax()), whole.shape)
    assert less[deepest] > 0.6 * whole[deepest]
    assert np.array_equal(part("own", 1, 0, "").imprint_mm, less), "kept or not, a part is the same"
    task = TouchPoseTask(presses=1, folder=folder, parts=1.0, turned=0.0)
    shown = [measured(task.sample(np.random.default_rng(k))["square"], "bubble").sum() for k in range(12)]
    low, high = float(less.sum()), float(whole.sum())
    assert min(shown) == pytest.approx(low, rel=1e-3)
    assert sum(low * 1.01 < one < high * 0.99 for one in shown) >= 2, "none lies between part and whole"


@pytest.mark.parametrize("sensor", ["gelslim", "soft_bubble"])
def test_a_pose_network_learns_where_things_are(sensor, folder):
    task = TouchPoseTask(sensor=sensor, presses=4, folder=folder, parts=0.0, name=1.0)
    examples = [task.sample(np.random.default_rng(k)) for k in range(8)]
    batch = tensors({name: np.stack([one[name] for one in examples]) for name in examples[0]}, "cpu")
    torch.manual_seed(0)
    inputs = 3 if sensor == "gelslim" else 1
    net = build("touch_pose", {"inputs": inputs, "things": len(taught()), "first": 8, "folds": 6, "think": 32}).train()
    optimiser = torch.optim.Adam(net.parameters(), 3e-3)
    before = task.figures(net, examples)
    for _ in range(60):
        loss, _ = task.loss(net, batch)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    after = task.figures(net, examples)
    assert after["shift, mm"] < 0.5 * before["shift, mm"]
    assert after["named"] == 1.0
    assert net.features(batch["square"]).shape == (8, 32)
