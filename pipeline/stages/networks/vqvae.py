"""The paper's baseline: a vector-quantised autoencoder from one sensor's change to another's.

van den Oord et al. 2017, with the names and shapes of the released network (`encoder.*`,
`codebook.embedding.weight`, `decoder.*`): two strided convolutions and two residual blocks down to
a quarter of the side, each position replaced by the nearest codebook entry, and the mirrored
decoder. The paper's is 256 wide with 16,385 codes.

As published, each position sees 50 of 128 pixels and does not know where it is. Between sensors of
different size, whose pixels do not correspond, it learns nothing and its codebook collapses.
`reprojects_input`, `dilation` and `has_position_bias` fix that; they are off unless the weights
were trained with them.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from pipeline.stages.networks.touch_formats import SIDE

_INITIAL_RANGE = 1.0  # times 1 / codes: the largest value of an untrained codebook
_MIN_POSITIONS_PER_ENTRY = 8  # positions per entry from which on unused entries are replaced


class VqVaeOutput(NamedTuple):
    """Output, and the terms of the codebook loss."""

    generated: Tensor  # (n, outputs, side, side)
    encoded: Tensor  # (n, width, side / 4, side / 4)
    quantised: Tensor  # nearest codebook entries, same shape


class VqVae(nn.Module):
    """Normalised squares (n, outputs, side, side) from those of another sensor (n, inputs, side,
    side).

    `half_turn`: the output has to be rotated by 180 degrees for the target's camera, as in the
    paper's data. `reprojects_input`: the input is resampled to the target's view
    (`image_condition.reproject_square`). `dilation`: of the two middle residual blocks.
    `has_position_bias`: the decoder has a learned bias per position.
    """

    def __init__(
        self,
        *,
        inputs: int = 3,
        outputs: int = 1,
        width: int = 256,
        codes: int = 16_385,
        half_turn: bool = False,
        reprojects_input: bool = False,
        dilation: int = 1,
        has_position_bias: bool = False,
    ) -> None:
        super().__init__()
        self.inputs = inputs
        self.outputs = outputs
        self.half_turn = bool(half_turn)
        self.reprojects_input = bool(reprojects_input)
        self.encoder = nn.Sequential(
            nn.Conv2d(inputs, width, 4, 2, 1),
            nn.ReLU(inplace=True),
            nn.Conv2d(width, width, 4, 2, 1),
            ResidualBlock(width),
            ResidualBlock(width, dilation),
        )
        self.codebook = Codebook(codes, width)
        self.decoder = nn.Sequential(
            ResidualBlock(width, dilation),
            ResidualBlock(width),
            nn.ReLU(inplace=True),
            nn.ConvTranspose2d(width, width, 4, 2, 1),
            nn.ReLU(inplace=True),
            nn.ConvTranspose2d(width, outputs, 4, 2, 1),
        )
        self.position_bias = (
            nn.Parameter(torch.zeros(1, width, SIDE // 4, SIDE // 4)) if has_position_bias else None
        )

    def forward(self, squares: Tensor) -> VqVaeOutput:
        """Translate the squares; gradients pass straight through the codebook."""
        encoded = self.encoder(squares)
        quantised = self.codebook(encoded)
        codes = encoded + (quantised - encoded).detach()
        generated = self.decoder(
            codes if self.position_bias is None else codes + self.position_bias
        )
        return VqVaeOutput(generated=generated, encoded=encoded, quantised=quantised)


class ResidualBlock(nn.Module):
    """A residual block that adds to its activated input, as the released in-place version does."""

    def __init__(self, width: int, dilation: int = 1) -> None:
        super().__init__()
        self.block = nn.Sequential(
            nn.ReLU(),
            nn.Conv2d(width, width, 3, 1, dilation, dilation),
            nn.ReLU(inplace=True),
            nn.Conv2d(width, width, 1),
        )

    def forward(self, field: Tensor) -> Tensor:
        """Features of the same shape."""
        positive = functional.relu(field)
        return positive + self.block[1:](positive)


class Codebook(nn.Module):
    """Nearest entry at every position; a new codebook is initialised from the first batch.

    An entry that is nearest to no position of a large batch is re-initialised at one of them.
    """

    def __init__(self, codes: int, width: int) -> None:
        super().__init__()
        self.embedding = nn.Embedding(codes, width)
        nn.init.uniform_(self.embedding.weight, -1.0 / codes, 1.0 / codes)

    def forward(self, encoded: Tensor) -> Tensor:
        """Entries (n, width, rows, cols), in float32 for any autocast precision."""
        positions = encoded.detach().float().permute(0, 2, 3, 1)
        flat = positions.reshape(-1, positions.shape[-1])
        if self.training and self._is_new():
            self._initialise(flat)
        index = self.assign_codes(flat)
        if self.training and len(flat) >= _MIN_POSITIONS_PER_ENTRY * self.embedding.num_embeddings:
            self._replace_unused(flat, index)
        with torch.autocast(encoded.device.type, enabled=False):
            entries = self.embedding(index).reshape(positions.shape)
        return entries.permute(0, 3, 1, 2)

    def assign_codes(self, positions: Tensor) -> Tensor:
        """Index (n,) of the nearest entry of each row of (n, width)."""
        entries = self.embedding.weight.detach()
        with torch.autocast(positions.device.type, enabled=False):
            return ((entries**2).sum(1) - 2.0 * positions @ entries.T).argmin(1)

    def _replace_unused(self, positions: Tensor, index: Tensor) -> None:
        unused = torch.bincount(index, minlength=self.embedding.num_embeddings) == 0
        chosen = self._choose(positions)
        with torch.no_grad():
            self.embedding.weight.copy_(torch.where(unused[:, None], chosen, self.embedding.weight))

    def _choose(self, positions: Tensor) -> Tensor:
        """A position for each entry."""
        n = self.embedding.num_embeddings
        return positions[torch.randint(len(positions), (n,), device=positions.device)]

    def _is_new(self) -> bool:
        return (
            float(self.embedding.weight.detach().abs().max())
            <= _INITIAL_RANGE / self.embedding.num_embeddings
        )

    def _initialise(self, positions: Tensor) -> None:
        chosen = self._choose(positions)
        with torch.no_grad():
            self.embedding.weight.copy_(chosen + 0.01 * positions.std() * torch.randn_like(chosen))
