"""Planar object pose and object class from the change of a tactile image: a small strided CNN.

The object may be given; otherwise the predicted class is used. The heading is predicted as cosine
and sine of k times the angle for every fold k of rotational symmetry: for a hexagon 29 and -31
degrees are equal, and no single angle represents that. The embedding of the classifier is also the
encoder that sets of touches are compared by.
"""

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn

from pipeline.stages.networks.touch_formats import SIDE

# output unit of the translation: half of the square in which objects are placed
TRANSLATION_UNIT_MM = 5.0


class PosePrediction(NamedTuple):
    """Prediction of each touch."""

    translation_mm: Tensor  # (n, 2) of the object's origin, along x and y of the alignment frame
    # (n, n_folds, 2) cosine and sine of 1, 2, ... times the rotation about z, not normalised
    headings: Tensor
    object_logits: Tensor  # (n, n_objects)


class TouchPose(nn.Module):
    """`PosePrediction` from normalised squares (n, inputs, 128, 128).

    `base_channels` channels, doubled at each level up to `max_channels`; `n_objects` classes,
    `embedding_size` features they are classified by, `n_folds` symmetry folds. With `hidden_size` 0
    the object cannot be given.
    """

    def __init__(
        self,
        *,
        inputs: int,
        n_objects: int,
        base_channels: int = 24,
        max_channels: int = 128,
        levels: int = 4,
        embedding_size: int = 32,
        n_folds: int = 1,
        hidden_size: int = 0,
    ) -> None:
        super().__init__()
        widths = [inputs, *(min(base_channels * 2**k, max_channels) for k in range(levels))]
        self.body = nn.Sequential(
            *(
                layer
                for narrow, wide in pairwise(widths)
                for layer in (
                    nn.Conv2d(narrow, wide, 3, 2, 1, bias=False),
                    nn.BatchNorm2d(wide),
                    nn.ReLU(inplace=True),
                    nn.Conv2d(wide, wide, 3, 1, 1, bias=False),
                    nn.BatchNorm2d(wide),
                    nn.ReLU(inplace=True),
                )
            )
        )
        side = SIDE >> levels
        # No pooling: the position in the image is the answer.
        self.thin = nn.Conv2d(widths[-1], 32, 1)
        self.fc1 = nn.Linear(32 * side * side, 128)
        self.embed = nn.Linear(128, embedding_size)
        self.classifier = nn.Linear(embedding_size, n_objects)
        self.n_objects = n_objects
        self.n_folds = n_folds
        self.fc2 = nn.Linear(128 + embedding_size + n_objects, hidden_size) if hidden_size else None
        self.pose = nn.Linear(hidden_size or 128 + embedding_size, 2 + 2 * n_folds)

    def compute_embedding(self, squares: Tensor) -> Tensor:
        """Features (n, embedding_size) of the encoder."""
        return self._encode(squares)[1]

    def forward(self, squares: Tensor, known_object: Tensor | None = None) -> PosePrediction:
        """Translation, headings and class of each touch.

        `known_object` (n, n_objects) is one-hot, 0 if unknown.
        """
        features, embedding = self._encode(squares)
        embedding = torch.relu(embedding)
        logits = self.classifier(embedding)
        hidden = torch.cat([features, embedding], dim=1)
        if self.fc2 is not None:
            given = (
                torch.zeros_like(logits) if known_object is None else known_object.to(logits.dtype)
            )
            hidden = torch.relu(self.fc2(torch.cat([hidden, given], dim=1)))
        pose = self.pose(hidden)
        headings = pose[:, 2:].reshape(len(pose), self.n_folds, 2)
        return PosePrediction(
            translation_mm=TRANSLATION_UNIT_MM * pose[:, :2],
            headings=headings,
            object_logits=logits,
        )

    def _encode(self, squares: Tensor) -> tuple[Tensor, Tensor]:
        thin = torch.relu(self.thin(self.body(squares)))
        features = torch.relu(self.fc1(thin.flatten(1)))
        return features, self.embed(features)
