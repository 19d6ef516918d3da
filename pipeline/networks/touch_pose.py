"""Where an object is, and which, from the change that a sensor's reading shows: a few strided convolutions.

Its last layer but one is also the encoder that sets of touches are compared by.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn

from pipeline.networks.squares import SIDE

UNIT_MM = 5.0  # of the shift: half of the square that objects are held over


class Told(NamedTuple):
    """What it says of each touch."""

    shift_mm: Tensor  # (n, 2) of the object's origin, along x and y of the alignment frame
    heading: Tensor  # (n, 2) cosine and sine of its turn about z, not of unit length
    thing: Tensor  # (n, things) logits


class TouchPose(nn.Module):
    """`Told` from normalised squares (n, inputs, 128, 128); `first` channels, twice as many a level, `widest` at most.

    `things` are the objects it can name, `seen` the features of its last layer but one.
    """

    def __init__(
        self, *, inputs: int, things: int, first: int = 24, widest: int = 128, levels: int = 4, seen: int = 32
    ) -> None:
        super().__init__()
        widths = [inputs, *(min(first * 2**k, widest) for k in range(levels))]
        self.body = nn.Sequential(*(
            layer
            for narrow, wide in pairwise(widths)
            for layer in (
                nn.Conv2d(narrow, wide, 3, 2, 1, bias=False), nn.BatchNorm2d(wide), nn.ReLU(inplace=True),
                nn.Conv2d(wide, wide, 3, 1, 1, bias=False), nn.BatchNorm2d(wide), nn.ReLU(inplace=True),
            )
        ))  # fmt: skip
        side = SIDE >> levels
        # Where in the picture things lie is all that matters: nothing is pooled.
        self.thin = nn.Conv2d(widths[-1], 32, 1)
        self.gather = nn.Linear(32 * side * side, 128)
        self.look = nn.Linear(128, seen)
        self.pose, self.name = nn.Linear(128 + seen, 4), nn.Linear(seen, things)

    def features(self, squares: Tensor) -> Tensor:
        """(n, seen) what the encoder sees."""
        return self._looked(squares)[1]

    def forward(self, squares: Tensor) -> Told:
        """Shift, heading and name of what touches."""
        gathered, seen = self._looked(squares)
        pose = self.pose(torch.cat([gathered, torch.relu(seen)], dim=1))
        return Told(shift_mm=UNIT_MM * pose[:, :2], heading=pose[:, 2:], thing=self.name(torch.relu(seen)))

    def _looked(self, squares: Tensor) -> tuple[Tensor, Tensor]:
        thin = torch.relu(self.thin(self.body(squares)))
        gathered = torch.relu(self.gather(thin.flatten(1)))
        return gathered, self.look(gathered)
