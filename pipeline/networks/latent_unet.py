"""The denoiser of latent diffusion, under the names of the published one (Dhariwal and Nichol 2021, as LDM takes it).

Residual blocks that also halve and double, attention at chosen levels, and the time of the noise as a scale and a shift
of every block's normalised features.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional


class LatentUnet(nn.Module):
    """What it holds the noise for (n, outputs, rows, cols), of (n, inputs, rows, cols) at times (n,) of the noise.

    `times` widens each level, `attention` names the levels by how much smaller they are than the first.
    """

    def __init__(
        self,
        *,
        inputs: int = 68,
        outputs: int = 4,
        width: int = 192,
        channel_multipliers: tuple[int, ...] = (1, 2, 2, 4, 4),
        blocks: int = 2,
        attention: tuple[int, ...] = (1, 2, 4, 8),
        heads: int = 8,
        groups: int = 32,
    ) -> None:
        super().__init__()
        self.width, told = width, 4 * width
        self.time_embed = nn.Sequential(nn.Linear(width, told), nn.SiLU(), nn.Linear(told, told))
        made = _Maker(told, heads, groups)
        self.input_blocks = nn.ModuleList([_Steps(nn.Conv2d(inputs, width, 3, padding=1))])
        here, smaller, beside = width, 1, [width]
        for level, factor in enumerate(channel_multipliers):
            for _ in range(blocks):
                self.input_blocks.append(made.make_steps(here, factor * width, attends=smaller in attention))
                here = factor * width
                beside.append(here)
            if level < len(channel_multipliers) - 1:
                self.input_blocks.append(_Steps(made.make_block(here, here, "halve")))
                beside.append(here)
                smaller *= 2
        self.middle_block = _Steps(made.make_block(here, here), made.make_attention(here), made.make_block(here, here))
        self.output_blocks = nn.ModuleList()
        for level, factor in reversed(list(enumerate(channel_multipliers))):
            for k in range(blocks + 1):
                steps = made.make_steps(here + beside.pop(), factor * width, attends=smaller in attention)
                here = factor * width
                if level and k == blocks:
                    steps.append(made.make_block(here, here, "double"))
                    smaller //= 2
                self.output_blocks.append(steps)
        self.out = nn.Sequential(
            nn.GroupNorm(groups, here), nn.SiLU(), _silent(nn.Conv2d(width, outputs, 3, padding=1))
        )

    def forward(self, noisy: Tensor, time: Tensor) -> Tensor:
        """The noise."""
        told = self.time_embed(embed_timesteps(time, self.width))
        field, beside = noisy, list[Tensor]()
        for steps in self.input_blocks:
            field = steps(field, told)
            beside.append(field)
        field = self.middle_block(field, told)
        for steps in self.output_blocks:
            field = steps(torch.cat([field, beside.pop()], dim=1), told)
        return self.out(field)


def embed_timesteps(time: Tensor, width: int) -> Tensor:
    """(n, width): cosines, then sines, of a time (n,) at frequencies from 1 down to 1/10,000."""
    half = width // 2
    angle = time[:, None].float() * torch.exp(-math.log(10_000.0) * torch.arange(half, device=time.device) / half)
    return torch.cat([torch.cos(angle), torch.sin(angle)], dim=1)


class _Maker:
    """Makes the parts, which all share these numbers."""

    def __init__(self, embedding_width: int, heads: int, groups: int) -> None:
        self._told, self._heads, self._groups = embedding_width, heads, groups

    def make_block(self, inputs: int, outputs: int, sized: str = "") -> nn.Module:
        return _Block(inputs, outputs, self._told, self._groups, sized)

    def make_attention(self, width: int) -> nn.Module:
        return _Attention(width, self._heads, self._groups)

    def make_steps(self, inputs: int, outputs: int, *, attends: bool) -> _Steps:
        return _Steps(self.make_block(inputs, outputs), *([self.make_attention(outputs)] if attends else []))


class _Steps(nn.Sequential):
    """Parts in a row; blocks are told the time."""

    def forward(self, field: Tensor, embedding: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        """One part after the other."""
        for part in self:
            field = part(field, embedding) if isinstance(part, _Block) else part(field)
        return field


class _Block(nn.Module):
    def __init__(self, inputs: int, outputs: int, embedding_width: int, groups: int, sized: str) -> None:
        super().__init__()
        self.in_layers = nn.Sequential(
            nn.GroupNorm(groups, inputs), nn.SiLU(), nn.Conv2d(inputs, outputs, 3, padding=1)
        )
        self.emb_layers = nn.Sequential(nn.SiLU(), nn.Linear(embedding_width, 2 * outputs))
        self.out_layers = nn.Sequential(
            nn.GroupNorm(groups, outputs), nn.SiLU(), nn.Identity(), _silent(nn.Conv2d(outputs, outputs, 3, padding=1))
        )
        self.skip_connection: nn.Module = nn.Identity() if inputs == outputs else nn.Conv2d(inputs, outputs, 1)
        self._sized = sized

    def forward(self, field: Tensor, embedding: Tensor) -> Tensor:
        """What is added to the field, at its new size."""
        inner, field = self._resized(self.in_layers[:-1](field)), self._resized(field)
        inner = self.in_layers[-1](inner)
        scale, shift = self.emb_layers(embedding)[:, :, None, None].chunk(2, dim=1)
        inner = self.out_layers[1:](self.out_layers[0](inner) * (1 + scale) + shift)
        return self.skip_connection(field) + inner

    def _resized(self, field: Tensor) -> Tensor:
        if self._sized == "halve":
            return functional.avg_pool2d(field, 2)
        if self._sized == "double":
            return functional.interpolate(field, scale_factor=2.0, mode="nearest")
        return field


class _Attention(nn.Module):
    def __init__(self, width: int, heads: int, groups: int) -> None:
        super().__init__()
        self._heads = heads
        self.norm = nn.GroupNorm(groups, width)
        self.qkv = nn.Conv1d(width, 3 * width, 1)
        self.proj_out = _silent(nn.Conv1d(width, width, 1))

    def forward(self, field: Tensor) -> Tensor:
        """Every place looks at every other; a head's question, key and value lie beside each other."""
        n, width = field.shape[:2]
        flat = field.reshape(n, width, -1)
        parts = self.qkv(self.norm(flat)).reshape(n, self._heads, 3, width // self._heads, -1).transpose(-1, -2)
        found = functional.scaled_dot_product_attention(parts[:, :, 0], parts[:, :, 1], parts[:, :, 2])
        return (flat + self.proj_out(found.transpose(-1, -2).reshape(n, width, -1))).reshape(field.shape)


def _silent(layer: Any) -> Any:
    """A layer that says nothing to begin with."""
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)
    return layer
