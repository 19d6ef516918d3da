"""From a loss to changed weights: the optimiser of a recipe, its learning rate, and the average of all weights."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pipeline.training.recipe import Optimiser

if TYPE_CHECKING:
    from torch import nn, optim

_POWER = 0.9  # of the schedule "poly", as depth networks of the DINOv2 family are trained


def make_optimiser(network: nn.Module, recipe: Optimiser, factors: Mapping[str, float]) -> optim.Optimizer:
    """An optimiser whose groups know their share of the learning rate: that of the longest beginning that fits."""
    from torch import optim

    shares: dict[float, list[Any]] = {}
    for name, parameter in network.named_parameters():
        fitting = [start for start in factors if name.startswith(start)]
        shares.setdefault(factors[max(fitting, key=len)] if fitting else 1.0, []).append(parameter)
    groups = [{"params": parameters, "share": share} for share, parameters in shares.items()]
    kind = optim.AdamW if recipe.kind == "adamw" else optim.Adam
    return kind(groups, lr=recipe.learning_rate, betas=(0.9, recipe.beta2), weight_decay=recipe.weight_decay)


def set_learning_rate(made: optim.Optimizer, rate: float) -> None:
    """Give every group its share of the learning rate."""
    for group in made.param_groups:
        group["lr"] = rate * group["share"]


def compute_learning_rate(recipe: Optimiser, step: int, fraction: float) -> float:
    """The rate of a step, `fraction` of the whole run being over (0..1)."""
    left = 1.0 - min(max(fraction, 0.0), 1.0)
    falling = {"cosine": 0.5 * (1.0 - math.cos(math.pi * left)), "poly": left**_POWER, "constant": 1.0}
    share = recipe.final_share + (1.0 - recipe.final_share) * falling[recipe.schedule]
    return recipe.learning_rate * share * min(1.0, (step + 1) / max(recipe.warm_up_steps, 1))


def copy_for_averaging(network: nn.Module) -> nn.Module:
    """A copy that the average of all weights is kept in."""
    return copy.deepcopy(network).eval().requires_grad_(requires_grad=False)


def update_average(mean: nn.Module, network: nn.Module, memory: float, step: int) -> None:
    """Move the average towards the network; young averages forget faster, so that the beginning leaves no trace."""
    import torch

    share = 1.0 - min(memory, (1.0 + step) / (10.0 + step))
    with torch.no_grad():
        for kept, new in zip(mean.state_dict().values(), network.state_dict().values(), strict=True):
            if kept.is_floating_point():
                kept.lerp_(new, share)
            else:
                kept.copy_(new)
