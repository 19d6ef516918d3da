"""Learning rates over a run, factors of parameter groups, and the moving average of the weights."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from pipeline.lab.training import loop
from pipeline.lab.training.recipe import Optimiser


@pytest.mark.parametrize("schedule", ["cosine", "poly", "constant"])
def test_the_rate_warms_up_and_falls_to_its_final_share(schedule):
    recipe = Optimiser(learning_rate=2.0, schedule=schedule, warm_up_steps=10, final_share=0.1)
    rates = [loop.compute_learning_rate(recipe, step, step / 100) for step in range(101)]
    assert rates[0] == pytest.approx(0.2, rel=0.05)
    assert max(rates) == max(rates[8:12])
    assert rates[-1] == pytest.approx(2.0 if schedule == "constant" else 0.2)
    assert np.all(np.diff(rates[10:]) <= 0)


def test_the_longest_matching_prefix_gives_the_factor_of_a_parameter():
    net = nn.ModuleDict({"encoder": nn.Linear(2, 2), "head": nn.Linear(2, 1)})
    made = loop.make_optimiser(
        net, Optimiser(learning_rate=1.0), {"encoder": 0.1, "encoder.bias": 0.5}
    )
    loop.set_learning_rate(made, 2.0)
    rates = {id(p): group["lr"] for group in made.param_groups for p in group["params"]}
    assert [rates[id(p)] for p in net.parameters()] == pytest.approx([0.2, 1.0, 2.0, 2.0])


def test_the_average_approaches_the_weights_and_copies_counters():
    net = nn.BatchNorm1d(3)
    mean = loop.copy_for_averaging(net)
    with torch.no_grad():
        net.weight.fill_(5.0)
    net(torch.randn(8, 3))
    for step in range(400):
        loop.update_average(mean, net, 0.99, step)
    assert torch.allclose(mean.weight, net.weight, atol=0.05)
    assert torch.allclose(mean.running_mean, net.running_mean, atol=0.05)
    assert mean.num_batches_tracked == 1
    assert not any(p.requires_grad for p in mean.parameters())
