"""To tell an object's pose from a sensor's own touches: the paper's tactile metric, and the encoder of sets of touches.

All objects of the catalogue are learned, the tools that translators never see among them: what is judged by this is a
touch, not this.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.base.params import setting
from pipeline.networks.squares import normal
from pipeline.simulation import shapes
from pipeline.training.paired_touches import PairedTouch, paired_touch, thing_names

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.task import Example, Split

Judged = Literal["gelslim", "soft_bubble"]
_HELD_OUT_SEED = 7
_TURN_MM = 10.0  # lever of a turn: what a radian counts for beside a shift


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchPoseTask:
    """Whose touches, and what counts for how much."""

    sensor: Judged = setting("soft_bubble", "Sensor", choices=Judged)
    presses: int = setting(2000, "Presses", low=1, high=10_000_000, help="of all objects, that examples are drawn from")
    pairs: int = setting(0, "Presses of pairs", low=0, high=10_000_000, help="of training objects, drawn from as well")
    press_seed: int = setting(1, "Seed of the presses", low=0, high=2**31 - 1)
    folder: str = setting("", "Folder", help="keeps the presses for other runs; empty = worked out each time")
    name: float = setting(0.3, "Weight of the object's name", low=0.0, high=100.0)

    def sample(self, rng: np.random.Generator) -> Example:
        """A touch and where its object is."""
        index = int(rng.integers(self.presses + self.pairs))
        if index < self.presses:
            touch = paired_touch("own", self.press_seed, index, self.folder)
        else:
            touch = self._of_a_pair(index - self.presses)
        return self._example(touch, float(rng.random()))

    def _of_a_pair(self, index: int) -> PairedTouch:
        """Touch `index` of those that translators learn from, or the next one of an object with a name."""
        while True:
            touch = paired_touch("learned", self.press_seed, index, self.folder)
            if touch.thing:
                return touch
            index += 1

    def held_out(self, split: Split, index: int) -> Example:
        """A touch as no object was ever held."""
        return self._example(paired_touch(split, _HELD_OUT_SEED, index, self.folder), 1.0)

    def loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """How far off the shift is and the turn, up to the object's symmetry, and how likely its name."""
        from torch.nn import functional

        told, truth = network(batch["square"]), batch["truth"]
        shift = functional.smooth_l1_loss(told.shift_mm, truth[:, :2])
        turn = (turn_cost(told.heading, truth[:, 2], truth[:, 3])).mean()
        name = functional.cross_entropy(told.thing, truth[:, 4].long())
        loss = shift + turn + self.name * name
        return loss, {"shift": shift.detach(), "turn": turn.detach(), "name": name.detach()}

    def figures(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Mean errors and how often the object is named."""
        import torch

        with torch.inference_mode():
            told = network(torch.from_numpy(np.stack([one["square"] for one in held_out])))
        truth = np.stack([one["truth"] for one in held_out])
        shift = np.hypot(*(told.shift_mm.numpy() - truth[:, :2]).T)
        angle = np.arctan2(told.heading[:, 1].numpy(), told.heading[:, 0].numpy()) - truth[:, 2]
        fold = np.maximum(truth[:, 3], 1.0)
        off = np.abs(np.angle(np.exp(1j * fold * angle))) / fold
        seen = truth[:, 3] > 0
        named = told.thing.numpy().argmax(1) == truth[:, 4]
        return {
            "shift, mm": float(shift.mean()), "turn, deg": float(np.degrees(off[seen].mean())),
            "named": float(named.mean()),
        }  # fmt: skip

    def _example(self, touch: PairedTouch, noise: float) -> Example:
        if self.sensor == "gelslim":
            square = normal(touch.own_gel, "gel")
        else:  # what is generated has less noise than what is recorded
            seen = touch.exact_mm + np.float32(noise) * (touch.bubble_mm - touch.exact_mm)
            square = normal(seen.astype(np.float32), "bubble")
        pose = touch.alignment_from_object
        turn = math.atan2(pose[1, 0], pose[0, 0])
        place = (pose[0, 3], pose[1, 3], turn, fold_of(touch.thing), thing_names().index(touch.thing))
        return {"square": square, "truth": np.array(place, np.float32)}


def turn_cost(heading: Tensor, turn_rad: Tensor, fold: Tensor) -> Tensor:
    """(n,) half the squared error of small turns in mm at the lever, least over an object's symmetry; see `fold_of`."""
    import torch

    angle = torch.atan2(heading[:, 1], heading[:, 0] + 1e-6)
    times = fold.clamp(min=1.0)
    cost = _TURN_MM * (1.0 - torch.cos(times * (angle - turn_rad))) / times**2
    return torch.where(fold > 0, cost, torch.zeros_like(cost))


@lru_cache(maxsize=64)
def fold_of(thing: str) -> float:
    """How many turns about its z map an object onto itself; 0 = all of them."""
    symmetry = shapes.shape(thing).symmetry
    if symmetry.axis is not None and abs(float(symmetry.axis[2])) > 0.99:
        return 0.0
    return float(sum(abs(float(turn[2, 2]) - 1.0) < 1e-6 for turn in symmetry.rotations))
