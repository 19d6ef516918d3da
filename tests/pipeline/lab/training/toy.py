"""A task and a network small enough to train in a second: segment a disc in noise."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from pipeline.core.params import setting
from pipeline.lab.training import task
from pipeline.lab.training.task import TaskEntry
from pipeline.stages.networks import network_factory

SIDE = 16
RECIPE = """
task = "discs"
seed = 3
batch = 4
steps = 60

[network]
kind = "toy_net"
width = 4

[optimiser]
learning_rate = 0.02
warm_up_steps = 5
ema_decay = 0.9

[validation]
n_evaluations = 2
n_examples = 6

[settings]
noise = 0.2
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Discs(task.Task):
    noise: float = setting(0.1, "Noise", low=0.0, high=1.0)
    bad_from: int = setting(-1, "Examples of NaN from this value on", low=-1, high=100)

    def sample(self, rng):
        y, x = np.mgrid[:SIDE, :SIDE]
        centre = rng.uniform(4, 12, 2)
        radius = rng.uniform(2, 5)
        disc = ((x - centre[0]) ** 2 + (y - centre[1]) ** 2 < radius**2).astype(np.float32)[None]
        image = disc + self.noise * rng.standard_normal(disc.shape).astype(np.float32)
        if 0 <= self.bad_from <= 100 * rng.random():
            image[:] = np.nan
        return {"image": image, "disc": disc}

    def make_validation_example(self, split, index):
        return Discs(noise=self.noise).sample(
            np.random.default_rng([9, task.SPLITS.index(split), index])
        )

    def compute_loss(self, network, batch):
        from torch.nn import functional

        loss = functional.binary_cross_entropy_with_logits(network(batch["image"]), batch["disc"])
        return loss, {"bce": loss.detach()}

    def evaluate(self, network, held_out):
        import torch

        predicted = (
            network(torch.from_numpy(np.stack([one["image"] for one in held_out]))).numpy() > 0
        )
        truth = np.stack([one["disc"] for one in held_out]) > 0.5
        return {"overlap, 1": float((predicted & truth).sum() / (predicted | truth).sum())}


@dataclass(frozen=True, slots=True, kw_only=True)
class SlowDiscs(Discs):
    def sample(self, rng):
        time.sleep(300.0)
        return Discs.sample(self, rng)


def toy_net(width):
    from torch import nn

    return nn.Sequential(
        nn.Conv2d(1, width, 5, padding=2),
        nn.GELU(),
        nn.Conv2d(width, width, 3, padding=1),
        nn.GELU(),
        nn.Conv2d(width, 1, 1),
    )


def register():
    """Add both to the tables of this process; worker processes receive the task by pickle."""
    task.TASKS["discs"] = TaskEntry(subcommand="discs", import_path=f"{__name__}:Discs")
    network_factory.NETWORK_CLASSES["toy_net"] = f"{__name__}:toy_net"
