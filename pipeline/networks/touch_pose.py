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

from pipeline.networks.square_images import SIDE

TRANSLATION_UNIT_MM = 5.0  # of the shift: half of the square that objects are held over


class PosePrediction(NamedTuple):
    """What it says of each touch."""

    translation_mm: Tensor  # (n, 2) of the object's origin, along x and y of the alignment frame
    headings: Tensor  # (n, folds, 2) cosine and sine of 1, 2, .. times its turn about z, not of unit length
    object_logits: Tensor  # (n, things) logits


class TouchPose(nn.Module):
    """`Told` from normalised squares (n, inputs, 128, 128); `first` channels, twice as many a level, `widest` at most.

    `things` are the objects it can name, `seen` the features that it names them by, `folds` the symmetries that a turn
    is told for; of 0 numbers to `think` with there is no saying which object it is.
    """

    def __init__(
        self, *, inputs: int, n_objects: int, base_channels: int = 24, max_channels: int = 128, levels: int = 4, embedding_size: int = 32,
        n_folds: int = 1, hidden_size: int = 0,
    ) -> None:  # fmt: skip
        super().__init__()
        widths = [inputs, *(min(base_channels * 2**k, max_channels) for k in range(levels))]
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
        self.fc1 = nn.Linear(32 * side * side, 128)
        self.embed = nn.Linear(128, embedding_size)
        self.classifier, self.n_objects, self.n_folds = nn.Linear(embedding_size, n_objects), n_objects, n_folds
        self.fc2 = nn.Linear(128 + embedding_size + n_objects, hidden_size) if hidden_size else None
        self.pose = nn.Linear(hidden_size or 128 + embedding_size, 2 + 2 * n_folds)

    def compute_embedding(self, squares: Tensor) -> Tensor:
        """(n, seen) what the encoder sees."""
        return self._looked(squares)[1]

    def forward(self, squares: Tensor, known_object: Tensor | None = None) -> PosePrediction:
        """Shift, headings and name of what touches; `known` (n, things) has a 1 for what it is known to be."""
        gathered, seen = self._looked(squares)
        seen = torch.relu(seen)
        name = self.classifier(seen)
        told = torch.cat([gathered, seen], dim=1)
        if self.fc2 is not None:
            said = torch.zeros_like(name) if known_object is None else known_object.to(name.dtype)
            told = torch.relu(self.fc2(torch.cat([told, said], dim=1)))
        pose = self.pose(told)
        headings = pose[:, 2:].reshape(len(pose), self.n_folds, 2)
        return PosePrediction(translation_mm=TRANSLATION_UNIT_MM * pose[:, :2], headings=headings, object_logits=name)

    def _looked(self, squares: Tensor) -> tuple[Tensor, Tensor]:
        thin = torch.relu(self.thin(self.body(squares)))
        gathered = torch.relu(self.fc1(thin.flatten(1)))
        return gathered, self.embed(gathered)
