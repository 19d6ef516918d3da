"""The KL autoencoder of latent diffusion (`kl-f8`, Rombach et al. 2022) with the published tensor
names.

It encodes three-channel images to a few channels at 1/8 of the side length, and decodes them.
"""

from collections import OrderedDict
from itertools import pairwise
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

LATENT_CHANNELS = 4
_EPS = 1e-6


class AutoencoderKl(nn.Module):
    """Mean and log variance of latents from images (n, 3, side, side), and images from latents."""

    def __init__(
        self, *, width: int, channel_multipliers: tuple[int, ...], blocks: int, groups: int
    ) -> None:
        super().__init__()
        self.encoder = _Encoder(width, channel_multipliers, blocks, groups)
        self.decoder = _Decoder(width, channel_multipliers, blocks, groups)
        self.quant_conv = nn.Conv2d(2 * LATENT_CHANNELS, 2 * LATENT_CHANNELS, 1)
        self.post_quant_conv = nn.Conv2d(LATENT_CHANNELS, LATENT_CHANNELS, 1)

    def encode(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """(mean, log variance), each (n, 4, rows / 8, cols / 8) with four levels."""
        mean, log_variance = self.quant_conv(self.encoder(images)).chunk(2, dim=1)
        return mean, log_variance.clamp(-30.0, 20.0)

    def decode(self, latents: Tensor) -> Tensor:
        """Decode latents to images (n, 3, rows, cols)."""
        return self.decoder(self.post_quant_conv(latents))


class _Encoder(nn.Module):
    def __init__(
        self, width: int, channel_multipliers: tuple[int, ...], blocks: int, groups: int
    ) -> None:
        super().__init__()
        widths = [width, *(width * factor for factor in channel_multipliers)]
        self.conv_in = nn.Conv2d(3, width, 3, padding=1)
        self.down = nn.ModuleList()
        for level, (inputs, outputs) in enumerate(pairwise(widths)):
            step = nn.Module()
            step.block = nn.ModuleList(
                _Block(inputs if k == 0 else outputs, outputs, groups) for k in range(blocks)
            )
            is_last = level == len(channel_multipliers) - 1
            step.downsample = nn.Identity() if is_last else _make_downsampling(outputs)
            self.down.append(step)
        self.mid = _Middle(widths[-1], groups)
        self.norm_out = nn.GroupNorm(groups, widths[-1], _EPS)
        self.conv_out = nn.Conv2d(widths[-1], 2 * LATENT_CHANNELS, 3, padding=1)

    def forward(self, images: Tensor) -> Tensor:
        """Moments before `quant_conv`."""
        field = self.conv_in(images)
        for step in self.down:
            for block in cast("nn.ModuleList", step.block):
                field = block(field)
            field = cast("nn.Module", step.downsample)(field)
        return self.conv_out(functional.silu(self.norm_out(self.mid(field))))


class _Decoder(nn.Module):
    def __init__(
        self, width: int, channel_multipliers: tuple[int, ...], blocks: int, groups: int
    ) -> None:
        super().__init__()
        widths = [width * factor for factor in channel_multipliers]
        self.conv_in = nn.Conv2d(LATENT_CHANNELS, widths[-1], 3, padding=1)
        self.mid = _Middle(widths[-1], groups)
        self.up = nn.ModuleList()
        for level, outputs in enumerate(widths):
            step = nn.Module()
            deeper = widths[min(level + 1, len(widths) - 1)]
            step.block = nn.ModuleList(
                _Block(deeper if k == 0 else outputs, outputs, groups) for k in range(blocks + 1)
            )
            step.upsample = _make_upsampling(outputs) if level else nn.Identity()
            self.up.append(step)
        self.norm_out = nn.GroupNorm(groups, widths[0], _EPS)
        self.conv_out = nn.Conv2d(widths[0], 3, 3, padding=1)

    def forward(self, latents: Tensor) -> Tensor:
        """Images (n, 3, rows, cols)."""
        field = self.mid(self.conv_in(latents))
        for step in reversed(self.up):
            for block in cast("nn.ModuleList", step.block):
                field = block(field)
            field = cast("nn.Module", step.upsample)(field)
        return self.conv_out(functional.silu(self.norm_out(field)))


class _Middle(nn.Module):
    def __init__(self, width: int, groups: int) -> None:
        super().__init__()
        self.block_1 = _Block(width, width, groups)
        self.block_2 = _Block(width, width, groups)
        self.attn_1 = _Attention(width, groups)

    def forward(self, field: Tensor) -> Tensor:
        return self.block_2(self.attn_1(self.block_1(field)))


class _Block(nn.Module):
    def __init__(self, inputs: int, outputs: int, groups: int) -> None:
        super().__init__()
        self.norm1 = nn.GroupNorm(groups, inputs, _EPS)
        self.norm2 = nn.GroupNorm(groups, outputs, _EPS)
        self.conv1 = nn.Conv2d(inputs, outputs, 3, padding=1)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1)
        self.nin_shortcut = nn.Identity() if inputs == outputs else nn.Conv2d(inputs, outputs, 1)

    def forward(self, field: Tensor) -> Tensor:
        inner = self.conv1(functional.silu(self.norm1(field)))
        inner = self.conv2(functional.silu(self.norm2(inner)))
        return inner + self.nin_shortcut(field)


class _Attention(nn.Module):
    def __init__(self, width: int, groups: int) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(groups, width, _EPS)
        self.q, self.k, self.v, self.proj_out = (nn.Conv2d(width, width, 1) for _ in range(4))

    def forward(self, field: Tensor) -> Tensor:
        normed = self.norm(field)
        query, key, value = (
            part(normed).flatten(2).transpose(1, 2) for part in (self.q, self.k, self.v)
        )
        attended = functional.scaled_dot_product_attention(query, key, value)
        return field + self.proj_out(attended.transpose(1, 2).reshape(field.shape))


def _make_downsampling(width: int) -> nn.Module:
    """To half the side length; as published, padding is added at the right and bottom only."""
    pad = nn.ZeroPad2d((0, 1, 0, 1))
    return nn.Sequential(OrderedDict(pad=pad, conv=nn.Conv2d(width, width, 3, stride=2)))


def _make_upsampling(width: int) -> nn.Module:
    enlarge = nn.Upsample(scale_factor=2.0, mode="nearest")
    return nn.Sequential(OrderedDict(enlarge=enlarge, conv=nn.Conv2d(width, width, 3, padding=1)))


def sample_latents(mean: Tensor, log_variance: Tensor, noise: Tensor) -> Tensor:
    """Sample latents from a normal distribution with this mean and log variance."""
    return mean + torch.exp(0.5 * log_variance) * noise
