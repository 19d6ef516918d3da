"""The optimiser of a recipe, its learning rate, and the moving average of the weights."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pipeline.lab.training.recipe import Optimiser

if TYPE_CHECKING:
    from torch import nn, optim

_POWER = 0.9  # of the schedule "poly", as depth networks on DINOv2 are trained


def make_optimiser(
    network: nn.Module, recipe: Optimiser, factors: Mapping[str, float]
) -> optim.Optimizer:
    """An optimiser with one parameter group for each factor of the learning rate.

    `factors` maps prefixes of parameter names to factors; the longest matching prefix applies, 1
    without one.
    """
    from torch import optim

    shares: dict[float, list[Any]] = {}
    for name, parameter in network.named_parameters():
        prefixes = [prefix for prefix in factors if name.startswith(prefix)]
        shares.setdefault(factors[max(prefixes, key=len)] if prefixes else 1.0, []).append(
            parameter
        )
    groups = [{"params": parameters, "share": share} for share, parameters in shares.items()]
    kind = optim.AdamW if recipe.kind == "adamw" else optim.Adam
    return kind(
        groups, lr=recipe.learning_rate, betas=(0.9, recipe.beta2), weight_decay=recipe.weight_decay
    )


def set_learning_rate(made: optim.Optimizer, rate: float) -> None:
    """Set the learning rate of every group."""
    for group in made.param_groups:
        group["lr"] = rate * group["share"]


def compute_learning_rate(recipe: Optimiser, step: int, fraction: float) -> float:
    """The learning rate of a step, where `fraction` (0..1) of the run is done."""
    left = 1.0 - min(max(fraction, 0.0), 1.0)
    falling = {
        "cosine": 0.5 * (1.0 - math.cos(math.pi * left)),
        "poly": left**_POWER,
        "constant": 1.0,
    }
    share = recipe.final_share + (1.0 - recipe.final_share) * falling[recipe.schedule]
    return recipe.learning_rate * share * min(1.0, (step + 1) / max(recipe.warm_up_steps, 1))


def copy_for_averaging(network: nn.Module) -> nn.Module:
    """A copy of the network that holds the moving average."""
    return copy.deepcopy(network).eval().requires_grad_(requires_grad=False)


def update_average(mean: nn.Module, network: nn.Module, decay: float, step: int) -> None:
    """Move the average towards the network, faster in the first steps, whose weights are far
    off.
    """
    import torch

    share = 1.0 - min(decay, (1.0 + step) / (10.0 + step))
    with torch.no_grad():
        for average, new in zip(
            mean.state_dict().values(), network.state_dict().values(), strict=True
        ):
            if average.is_floating_point():
                average.lerp_(new, share)
            else:
                average.copy_(new)
