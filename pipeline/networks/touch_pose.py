"""Where an object is, and which, from the change that a sensor's reading shows: a few strided convolutions.

Which object it is may be said; else it goes by what it sees. A turn is told for every symmetry that an object may have,
as cosine and sine of so many times the angle: of a hexagon 29 and -31 degrees are the same, and no angle says so.
What it names objects by is also the encoder that sets of touches are compared by.
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
    headings: Tensor  # (n, folds, 2) cosine and sine of 1, 2, .. times its turn about z, not of unit length
    thing: Tensor  # (n, things) logits


class TouchPose(nn.Module):
    """`Told` from normalised squares (n, inputs, 128, 128); `first` channels, twice as many a level, `widest` at most.

    `things` are the objects it can name, `seen` the features that it names them by, `folds` the symmetries that a turn
    is told for; of 0 numbers to `think` with there is no saying which object it is.
    """

    def __init__(
        self, *, inputs: int, things: int, first: int = 24, widest: int = 128, levels: int = 4, seen: int = 32,
        folds: int = 1, think: int = 0,
    ) -> None:  # fmt: skip
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
        self.name, self.things, self.folds = nn.Linear(seen, things), things, folds
        self.think = nn.Linear(128 + seen + things, think) if think else None
        self.pose = nn.Linear(think or 128 + seen, 2 + 2 * folds)

    def features(self, squares: Tensor) -> Tensor:
        """(n, seen) what the encoder sees."""
        return self._looked(squares)[1]

    def forward(self, squares: Tensor, known: Tensor | None = None) -> Told:
        """Shift, headings and name of what touches; `known` (n, things) has a 1 for what it is known to be."""
        gathered, seen = self._looked(squares)
        seen = torch.relu(seen)
        name = self.name(seen)
        told = torch.cat([gathered, seen], dim=1)
        if self.think is not None:
            said = torch.zeros_like(name) if known is None else known.to(name.dtype)
            told = torch.relu(self.think(torch.cat([told, said], dim=1)))
        pose = self.pose(told)
        headings = pose[:, 2:].reshape(len(pose), self.folds, 2)
        return Told(shift_mm=UNIT_MM * pose[:, :2], headings=headings, thing=name)

    def _looked(self, squares: Tensor) -> tuple[Tensor, Tensor]:
        thin = torch.relu(self.thin(self.body(squares)))
        gathered = torch.relu(self.gather(thin.flatten(1)))
        return gathered, self.look(gathered)
