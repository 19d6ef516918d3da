"""The paper's baseline: a vector-quantised autoencoder that takes one sensor's change for another's.

van den Oord et al. 2017, under the names and shapes of the released one (`encoder.*`, `codebook.embedding.weight`,
`decoder.*`): two strided convolutions and two residual blocks down to a quarter of the side, each place there replaced
by the nearest entry of a codebook, and the same way back. The paper's is 256 wide with 16,385 codes.

As published it sees 50 of 128 pixels around each place, and knows not where that is: between two sensors of other
sizes, whose pixels do not belong together, it can tell nothing and its codes fall together. `laid`, `reach` and
`placed` mend that; they are off unless weights were learned with them.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from pipeline.networks.square_images import SIDE

_SPREAD = 1.0  # a codebook as wide as this is no new one
_MANY = 8  # places for each entry, of which one that is used should have some


class VqVaeOutput(NamedTuple):
    """What comes out, and what the codebook is taught by."""

    generated: Tensor  # (n, outputs, side, side)
    encoded: Tensor  # (n, width, side / 4, side / 4) what the encoder says
    quantised: Tensor  # the same as codes


class VqVae(nn.Module):
    """Normalised squares (n, outputs, side, side) from those of another sensor (n, inputs, side, side); see `forward`.

    `half_turn`: what comes out is to be turned by half a turn to lie as the target's camera sees it, as in the paper's
    data, whose pairs were turned so. `laid`: what goes in was drawn where the target looks (`picture_input.laid`).
    `reach`: how far apart a convolution's samples lie in the two middle residual blocks of the four. `placed`: the
    decoder is told where it is.
    """

    def __init__(
        self, *, inputs: int = 3, outputs: int = 1, width: int = 256, codes: int = 16_385, half_turn: bool = False,
        reprojects_input: bool = False, dilation: int = 1, has_position_bias: bool = False,
    ) -> None:  # fmt: skip
        super().__init__()
        self.inputs, self.outputs, self.half_turn, self.reprojects_input = (
            inputs,
            outputs,
            bool(half_turn),
            bool(reprojects_input),
        )
        self.encoder = nn.Sequential(
            nn.Conv2d(inputs, width, 4, 2, 1), nn.ReLU(inplace=True), nn.Conv2d(width, width, 4, 2, 1),
            ResidualBlock(width), ResidualBlock(width, dilation),
        )  # fmt: skip
        self.codebook = Codebook(codes, width)
        self.decoder = nn.Sequential(
            ResidualBlock(width, dilation), ResidualBlock(width), nn.ReLU(inplace=True), nn.ConvTranspose2d(width, width, 4, 2, 1),
            nn.ReLU(inplace=True), nn.ConvTranspose2d(width, outputs, 4, 2, 1),
        )  # fmt: skip
        self.position_bias = nn.Parameter(torch.zeros(1, width, SIDE // 4, SIDE // 4)) if has_position_bias else None

    def forward(self, squares: Tensor) -> VqVaeOutput:
        """Gradients pass the codebook as if it were not there."""
        encoded = self.encoder(squares)
        quantised = self.codebook(encoded)
        seen = encoded + (quantised - encoded).detach()
        made = self.decoder(seen if self.position_bias is None else seen + self.position_bias)
        return VqVaeOutput(generated=made, encoded=encoded, quantised=quantised)


class ResidualBlock(nn.Module):
    """A residual block that adds to what its first activation leaves, as the released one does by working in place."""

    def __init__(self, width: int, dilation: int = 1) -> None:
        super().__init__()
        self.block = nn.Sequential(
            nn.ReLU(),
            nn.Conv2d(width, width, 3, 1, dilation, dilation),
            nn.ReLU(inplace=True),
            nn.Conv2d(width, width, 1),
        )

    def forward(self, field: Tensor) -> Tensor:
        """The same shape."""
        positive = functional.relu(field)
        return positive + self.block[3](self.block[2](self.block[1](positive)))


class Codebook(nn.Module):
    """The nearest of its entries at every place; new ones begin at what the encoder says of a first batch.

    Where an entry is nearest to none of a batch's places, though they are many, it begins anew at one of them.
    """

    def __init__(self, codes: int, width: int) -> None:
        super().__init__()
        self.embedding = nn.Embedding(codes, width)
        nn.init.uniform_(self.embedding.weight, -1.0 / codes, 1.0 / codes)

    def forward(self, encoded: Tensor) -> Tensor:
        """(n, width, rows, cols) of entries, in float32 whatever the rest computes in."""
        places = encoded.detach().float().permute(0, 2, 3, 1)
        flat = places.reshape(-1, places.shape[-1])
        if self.training and self._is_new():
            self._begin(flat)
        index = self.assign_codes(flat)
        if self.training and len(flat) >= _MANY * self.embedding.num_embeddings:
            self._begin_unused(flat, index)
        with torch.autocast(encoded.device.type, enabled=False):
            found = self.embedding(index).reshape(places.shape)
        return found.permute(0, 3, 1, 2)

    def assign_codes(self, places: Tensor) -> Tensor:
        """Which entry (n,) lies nearest to each row of (n, width)."""
        entries = self.embedding.weight.detach()
        with torch.autocast(places.device.type, enabled=False):
            return ((entries**2).sum(1) - 2.0 * places @ entries.T).argmin(1)

    def _begin_unused(self, places: Tensor, index: Tensor) -> None:
        unused = torch.bincount(index, minlength=self.embedding.num_embeddings) == 0
        chosen = torch.randint(len(places), (self.embedding.num_embeddings,), device=places.device)
        with torch.no_grad():
            self.embedding.weight.copy_(torch.where(unused[:, None], places[chosen], self.embedding.weight))

    def _is_new(self) -> bool:
        return float(self.embedding.weight.detach().abs().max()) <= _SPREAD / self.embedding.num_embeddings

    def _begin(self, places: Tensor) -> None:
        chosen = torch.randint(len(places), (self.embedding.num_embeddings,), device=places.device)
        with torch.no_grad():
            self.embedding.weight.copy_(places[chosen] + 0.01 * places.std() * torch.randn_like(places[chosen]))
