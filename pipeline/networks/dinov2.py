"""The encoder of Depth Anything V2: a DINOv2 vision transformer under the names of its published weights.

Oquab et al. 2023, patches of 14 pixels, without register tokens; small, base and large.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from pipeline.networks.depth_anything_input import PATCH_PX

_TAUGHT_PATCHES = 37  # a side: 518 pixels
_OFFSET = 0.1  # patches: how the published weights were taught to stretch their places over other sizes


@dataclass(frozen=True, slots=True, kw_only=True)
class EncoderSize:
    """One of the published sizes."""

    width: int
    depth: int
    heads: int
    output_blocks: tuple[int, ...]  # the blocks whose tokens the decoder reads


ENCODER_SIZES = {
    "vits": EncoderSize(width=384, depth=12, heads=6, output_blocks=(2, 5, 8, 11)),
    "vitb": EncoderSize(width=768, depth=12, heads=12, output_blocks=(2, 5, 8, 11)),
    "vitl": EncoderSize(width=1024, depth=24, heads=16, output_blocks=(4, 11, 17, 23)),
}


class DinoV2Encoder(nn.Module):
    """Tokens of every patch after some of the blocks, normalised."""

    def __init__(self, size: EncoderSize) -> None:
        super().__init__()
        self.output_blocks = size.output_blocks
        self.cls_token = nn.Parameter(torch.zeros(1, 1, size.width))
        self.pos_embed = nn.Parameter(torch.zeros(1, _TAUGHT_PATCHES**2 + 1, size.width))
        self.mask_token = nn.Parameter(torch.zeros(1, size.width))  # of its own training; nothing reads it here
        self.patch_embed = _PatchEmbed(size.width)
        self.blocks = nn.ModuleList(_Block(size) for _ in range(size.depth))
        self.norm = nn.LayerNorm(size.width, eps=1e-6)
        nn.init.trunc_normal_(self.pos_embed, std=0.02)
        nn.init.normal_(self.cls_token, std=1e-6)

    def forward(self, picture: Tensor, window: tuple[int, int, int, int]) -> list[Tensor]:
        """(n, patches, width) each for pictures (n, 3, rows, cols) of whole patches.

        `window` (top, left, rows, cols) in patches says where in a picture of rows x cols they are cut out of.
        """
        patches = self.patch_embed(picture)
        n, _, rows, cols = patches.shape
        top, left, whole_rows, whole_cols = window
        first, places = self._places(whole_rows, whole_cols)
        places = places[:, :, top : top + rows, left : left + cols]
        tokens = (patches + places).flatten(2).transpose(1, 2)
        tokens = torch.cat((self.cls_token.expand(n, -1, -1) + first, tokens), dim=1)
        found: list[Tensor] = []
        for index, block in enumerate(self.blocks):
            tokens = block(tokens)
            if index in self.output_blocks:
                found.append(self.norm(tokens)[:, 1:])
        return found

    def _places(self, rows: int, cols: int) -> tuple[Tensor, Tensor]:
        """What is added to the first token (1, 1, width), and to every patch (1, width, rows, cols)."""
        first, places = self.pos_embed[:, :1], self.pos_embed[:, 1:]
        side = _TAUGHT_PATCHES
        places = places.reshape(1, side, side, -1).permute(0, 3, 1, 2)
        if (rows, cols) == (side, side):
            return first, places
        scale = ((rows + _OFFSET) / math.sqrt(side**2), (cols + _OFFSET) / math.sqrt(side**2))
        return first, functional.interpolate(places.float(), scale_factor=scale, mode="bicubic")


class _PatchEmbed(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, width, PATCH_PX, stride=PATCH_PX)

    def forward(self, picture: Tensor) -> Tensor:
        return self.proj(picture)


class _Block(nn.Module):
    def __init__(self, size: EncoderSize) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(size.width, eps=1e-6)
        self.attn = _Attention(size.width, size.heads)
        self.ls1 = _Scale(size.width)
        self.norm2 = nn.LayerNorm(size.width, eps=1e-6)
        self.mlp = _Mlp(size.width)
        self.ls2 = _Scale(size.width)

    def forward(self, tokens: Tensor) -> Tensor:
        tokens = tokens + self.ls1(self.attn(self.norm1(tokens)))
        return tokens + self.ls2(self.mlp(self.norm2(tokens)))


class _Attention(nn.Module):
    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv, self.proj = _line(width, 3 * width), _line(width, width)

    def forward(self, tokens: Tensor) -> Tensor:
        n, count, width = tokens.shape
        parts = self.qkv(tokens).reshape(n, count, 3, self.heads, width // self.heads).permute(2, 0, 3, 1, 4)
        seen = functional.scaled_dot_product_attention(parts[0], parts[1], parts[2])
        return self.proj(seen.transpose(1, 2).reshape(n, count, width))


class _Mlp(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.fc1, self.fc2 = _line(width, 4 * width), _line(4 * width, width)

    def forward(self, tokens: Tensor) -> Tensor:
        return self.fc2(functional.gelu(self.fc1(tokens)))


class _Scale(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.ones(width))

    def forward(self, tokens: Tensor) -> Tensor:
        return tokens * self.gamma


def _line(inputs: int, outputs: int) -> nn.Linear:
    made = nn.Linear(inputs, outputs)
    nn.init.trunc_normal_(made.weight, std=0.02)
    nn.init.zeros_(made.bias)
    return made
