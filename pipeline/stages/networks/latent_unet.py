"""The denoiser of latent diffusion with the published tensor names (Dhariwal and Nichol 2021, as
used by LDM).

Residual blocks that also resample, attention at chosen levels, and a time embedding that scales and
shifts the normalised features of every block.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional


class LatentUnet(nn.Module):
    """Predicted noise (n, outputs, rows, cols) of latents (n, inputs, rows, cols) at times (n,).

    `channel_multipliers` sets the width of each level, `attention` the downsampling factors that
    have attention.
    """

    def __init__(
        self,
        *,
        inputs: int,
        outputs: int,
        width: int,
        channel_multipliers: tuple[int, ...],
        blocks: int,
        attention: tuple[int, ...],
        heads: int,
        groups: int,
    ) -> None:
        super().__init__()
        self.width = width
        embedding_width = 4 * width
        self.time_embed = nn.Sequential(
            nn.Linear(width, embedding_width),
            nn.SiLU(),
            nn.Linear(embedding_width, embedding_width),
        )

        def make_block(inputs: int, outputs: int, resampling: str = "") -> nn.Module:
            return _Block(inputs, outputs, embedding_width, groups, resampling)

        def make_steps(inputs: int, outputs: int, level: int) -> _Steps:
            steps = _Steps(make_block(inputs, outputs))
            if 2**level in attention:
                steps.append(_Attention(outputs, heads, groups))
            return steps

        self.input_blocks = nn.ModuleList([_Steps(nn.Conv2d(inputs, width, 3, padding=1))])
        channels = width
        skips = [width]
        levels = list(enumerate(channel_multipliers))
        for level, factor in levels:
            for _ in range(blocks):
                self.input_blocks.append(make_steps(channels, factor * width, level))
                channels = factor * width
                skips.append(channels)
            if level < len(levels) - 1:
                self.input_blocks.append(_Steps(make_block(channels, channels, "halve")))
                skips.append(channels)
        self.middle_block = _Steps(
            make_block(channels, channels),
            _Attention(channels, heads, groups),
            make_block(channels, channels),
        )
        self.output_blocks = nn.ModuleList()
        for level, factor in reversed(levels):
            for k in range(blocks + 1):
                steps = make_steps(channels + skips.pop(), factor * width, level)
                channels = factor * width
                if level and k == blocks:
                    steps.append(make_block(channels, channels, "double"))
                self.output_blocks.append(steps)
        self.out = nn.Sequential(
            nn.GroupNorm(groups, channels),
            nn.SiLU(),
            _zero_initialise(nn.Conv2d(width, outputs, 3, padding=1)),
        )

    def forward(self, noisy: Tensor, time: Tensor) -> Tensor:
        """Predict the noise."""
        embedding = self.time_embed(embed_timesteps(time, self.width))
        field = noisy
        skips = list[Tensor]()
        for steps in self.input_blocks:
            field = steps(field, embedding)
            skips.append(field)
        field = self.middle_block(field, embedding)
        for steps in self.output_blocks:
            field = steps(torch.cat([field, skips.pop()], dim=1), embedding)
        return self.out(field)


def embed_timesteps(time: Tensor, width: int) -> Tensor:
    """(n, width): cosines, then sines, of times (n,) at frequencies from 1 down to 1/10,000."""
    half = width // 2
    angle = time[:, None].float() * torch.exp(
        -math.log(10_000.0) * torch.arange(half, device=time.device) / half
    )
    return torch.cat([torch.cos(angle), torch.sin(angle)], dim=1)


class _Steps(nn.Sequential):
    """A sequence of layers; blocks also receive the time embedding."""

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, field: Tensor, embedding: Tensor
    ) -> Tensor:
        for part in self:
            field = part(field, embedding) if isinstance(part, _Block) else part(field)
        return field


class _Block(nn.Module):
    def __init__(
        self, inputs: int, outputs: int, embedding_width: int, groups: int, resampling: str
    ) -> None:
        super().__init__()
        self.in_layers = nn.Sequential(
            nn.GroupNorm(groups, inputs), nn.SiLU(), nn.Conv2d(inputs, outputs, 3, padding=1)
        )
        self.emb_layers = nn.Sequential(nn.SiLU(), nn.Linear(embedding_width, 2 * outputs))
        self.out_layers = nn.Sequential(
            nn.GroupNorm(groups, outputs),
            nn.SiLU(),
            nn.Identity(),
            _zero_initialise(nn.Conv2d(outputs, outputs, 3, padding=1)),
        )
        self.skip_connection: nn.Module = (
            nn.Identity() if inputs == outputs else nn.Conv2d(inputs, outputs, 1)
        )
        self._resample: nn.Module = {
            "halve": nn.AvgPool2d(2),
            "double": nn.Upsample(scale_factor=2.0, mode="nearest"),
        }.get(resampling, nn.Identity())

    def forward(self, field: Tensor, embedding: Tensor) -> Tensor:
        inner = self._resample(self.in_layers[:-1](field))
        field = self._resample(field)
        inner = self.in_layers[-1](inner)
        scale, shift = self.emb_layers(embedding)[:, :, None, None].chunk(2, dim=1)
        inner = self.out_layers[1:](self.out_layers[0](inner) * (1 + scale) + shift)
        return self.skip_connection(field) + inner


class _Attention(nn.Module):
    def __init__(self, width: int, heads: int, groups: int) -> None:
        super().__init__()
        self._heads = heads
        self.norm = nn.GroupNorm(groups, width)
        self.qkv = nn.Conv1d(width, 3 * width, 1)
        self.proj_out = _zero_initialise(nn.Conv1d(width, width, 1))

    def forward(self, field: Tensor) -> Tensor:
        """Self-attention over all positions, added to the input.

        Query, key and value are interleaved per head.
        """
        n, width = field.shape[:2]
        flat = field.reshape(n, width, -1)
        parts = (
            self.qkv(self.norm(flat))
            .reshape(n, self._heads, 3, width // self._heads, -1)
            .transpose(-1, -2)
        )
        attended = functional.scaled_dot_product_attention(
            parts[:, :, 0], parts[:, :, 1], parts[:, :, 2]
        )
        return (flat + self.proj_out(attended.transpose(-1, -2).reshape(n, width, -1))).reshape(
            field.shape
        )


def _zero_initialise(layer: Any) -> Any:
    """Initialise a layer to zero, so that it contributes nothing at first."""
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)
    return layer
