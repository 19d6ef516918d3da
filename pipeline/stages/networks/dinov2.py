"""The encoder of Depth Anything V2: a DINOv2 vision transformer with the published tensor names.

Oquab et al. 2023, patches of 14 pixels, no register tokens; small, base and large.
"""

from collections import OrderedDict

import torch
from torch import Tensor, nn
from torch.nn import functional

from pipeline.core.frozen import frozen
from pipeline.stages.networks.depth_anything_input import PATCH_PX

_TRAINED_PATCHES = 37  # per side of the position embeddings, 518 px
_OFFSET = 0.1  # patches, added when position embeddings are resized, as in the published training


@frozen
class EncoderSize:
    """One of the published model sizes, or the smaller "vitt" of ours."""

    width: int
    depth: int
    heads: int
    output_blocks: tuple[int, ...]  # blocks whose tokens the decoder reads
    features: int  # channels of the decoder, and of the tokens that it projects
    projected: tuple[int, ...]


ENCODER_SIZES = {
    name: EncoderSize(
        width=width,
        depth=blocks[-1] + 1,
        heads=width // 64,
        output_blocks=blocks,
        features=features,
        projected=projected,
    )
    for name, width, blocks, features, projected in (
        ("vitt", 192, (2, 5, 8, 11), 32, (24, 48, 96, 192)),
        ("vits", 384, (2, 5, 8, 11), 64, (48, 96, 192, 384)),
        ("vitb", 768, (2, 5, 8, 11), 128, (96, 192, 384, 768)),
        ("vitl", 1024, (4, 11, 17, 23), 256, (256, 512, 1024, 1024)),
    )
}


class DinoV2Encoder(nn.Module):
    """Normalised patch tokens after the selected blocks."""

    def __init__(self, size: EncoderSize) -> None:
        super().__init__()
        self.output_blocks = size.output_blocks
        self.cls_token = nn.Parameter(torch.zeros(1, 1, size.width))
        self.pos_embed = nn.Parameter(torch.zeros(1, _TRAINED_PATCHES**2 + 1, size.width))
        self.mask_token = nn.Parameter(torch.zeros(1, size.width))  # used in pre-training only
        filters = nn.Conv2d(3, size.width, PATCH_PX, stride=PATCH_PX)
        self.patch_embed = nn.Sequential(OrderedDict(proj=filters))
        self.blocks = nn.ModuleList(_Block(size) for _ in range(size.depth))
        self.norm = nn.LayerNorm(size.width, eps=1e-6)
        nn.init.trunc_normal_(self.pos_embed, std=0.02)
        nn.init.normal_(self.cls_token, std=1e-6)

    def forward(self, image: Tensor, window: tuple[int, int, int, int]) -> list[Tensor]:
        """List of tokens (n, patches, width), one per output block, for images (n, 3, rows, cols)
        of whole patches.

        `window` (top, left, rows, cols) in patches places this crop in an image of rows x cols
        patches.
        """
        patches = self.patch_embed(image)
        n, _, rows, cols = patches.shape
        top, left, whole_rows, whole_cols = window
        first, positions = self._position_embeddings(whole_rows, whole_cols)
        positions = positions[:, :, top : top + rows, left : left + cols]
        tokens = (patches + positions).flatten(2).transpose(1, 2)
        tokens = torch.cat((self.cls_token.expand(n, -1, -1) + first, tokens), dim=1)
        outputs: list[Tensor] = []
        for index, block in enumerate(self.blocks):
            tokens = block(tokens)
            if index in self.output_blocks:
                outputs.append(self.norm(tokens)[:, 1:])
        return outputs

    def _position_embeddings(self, rows: int, cols: int) -> tuple[Tensor, Tensor]:
        """Position embeddings of the class token (1, 1, width) and of all patches (1, width,
        rows, cols).
        """
        first = self.pos_embed[:, :1]
        positions = self.pos_embed[:, 1:]
        side = _TRAINED_PATCHES
        positions = positions.reshape(1, side, side, -1).permute(0, 3, 1, 2)
        if (rows, cols) == (side, side):
            return first, positions
        scale = ((rows + _OFFSET) / side, (cols + _OFFSET) / side)
        return first, functional.interpolate(positions.float(), scale_factor=scale, mode="bicubic")


class _Block(nn.Module):
    def __init__(self, size: EncoderSize) -> None:
        super().__init__()
        width = size.width
        self.norm1, self.norm2 = (nn.LayerNorm(width, eps=1e-6) for _ in range(2))
        self.attn = _Attention(width, size.heads)
        self.mlp = nn.Sequential(
            OrderedDict(fc1=_linear(width, 4 * width), act=nn.GELU(), fc2=_linear(4 * width, width))
        )
        self.ls1, self.ls2 = (nn.ParameterDict({"gamma": torch.ones(width)}) for _ in range(2))

    def forward(self, tokens: Tensor) -> Tensor:
        tokens = tokens + self.attn(self.norm1(tokens)) * self.ls1["gamma"]
        return tokens + self.mlp(self.norm2(tokens)) * self.ls2["gamma"]


class _Attention(nn.Module):
    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = _linear(width, 3 * width)
        self.proj = _linear(width, width)

    def forward(self, tokens: Tensor) -> Tensor:
        n, count, width = tokens.shape
        parts = (
            self.qkv(tokens)
            .reshape(n, count, 3, self.heads, width // self.heads)
            .permute(2, 0, 3, 1, 4)
        )
        attended = functional.scaled_dot_product_attention(parts[0], parts[1], parts[2])
        return self.proj(attended.transpose(1, 2).reshape(n, count, width))


def _linear(inputs: int, outputs: int) -> nn.Linear:
    layer = nn.Linear(inputs, outputs)
    nn.init.trunc_normal_(layer.weight, std=0.02)
    nn.init.zeros_(layer.bias)
    return layer
