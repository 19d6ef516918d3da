"""Touch to touch's network by its definition, from a checkpoint's tensors: the parts that the tests
compare with.

Written from Rombach et al. 2022 (kl-f8), Dhariwal and Nichol 2021 (denoiser) and He et al. 2016
(ResNet-18) with plain sums and products, for the configuration `gelslim2bubble.yaml` of touch2touch
at any width.
"""

from __future__ import annotations

import math

import torch
from torch.nn import functional

GROUPS = 32
HEADS = 8
LEVELS = 5


class Published:
    """A checkpoint's tensors under one prefix."""

    def __init__(self, tensors, prefix=""):
        self.tensors = tensors
        self.prefix = prefix

    def __getitem__(self, name):
        return self.tensors[self.prefix + name]

    def has(self, name):
        return self.prefix + name in self.tensors

    def conv(self, name, x, **how):
        return functional.conv2d(x, self[f"{name}.weight"], self[f"{name}.bias"], **how)

    def norm(self, name, x, eps):
        flat = x.reshape(x.shape[0], GROUPS, -1)
        mean = flat.mean(-1, keepdim=True)
        scaled = (
            (flat - mean) / ((flat - mean).pow(2).mean(-1, keepdim=True) + eps).sqrt()
        ).reshape(x.shape)
        shape = (-1, *[1] * (x.ndim - 2))
        return scaled * self[f"{name}.weight"].reshape(shape) + self[f"{name}.bias"].reshape(shape)


def swish(x):
    return x / (1 + torch.exp(-x))


# The autoencoder.


def residual(net, name, x):
    inner = net.conv(f"{name}.conv1", swish(net.norm(f"{name}.norm1", x, 1e-6)), padding=1)
    inner = net.conv(f"{name}.conv2", swish(net.norm(f"{name}.norm2", inner, 1e-6)), padding=1)
    return inner + (
        net.conv(f"{name}.nin_shortcut", x) if net.has(f"{name}.nin_shortcut.weight") else x
    )


def middle(net, name, x):
    x = residual(net, f"{name}.block_1", x)
    normed = net.norm(f"{name}.attn_1.norm", x, 1e-6)
    q, k, v = (net.conv(f"{name}.attn_1.{part}", normed).flatten(2) for part in "qkv")
    likeness = torch.softmax(torch.einsum("bci,bcj->bij", q, k) / math.sqrt(q.shape[1]), dim=-1)
    attended = torch.einsum("bij,bcj->bci", likeness, v).reshape(x.shape)
    return residual(net, f"{name}.block_2", x + net.conv(f"{name}.attn_1.proj_out", attended))


def encode(net, image):
    """Mean of the latents."""
    x = net.conv("encoder.conv_in", image, padding=1)
    for level in range(4):
        for k in range(2):
            x = residual(net, f"encoder.down.{level}.block.{k}", x)
        if level < 3:
            x = net.conv(
                f"encoder.down.{level}.downsample.conv", functional.pad(x, (0, 1, 0, 1)), stride=2
            )
    x = swish(net.norm("encoder.norm_out", middle(net, "encoder.mid", x), 1e-6))
    return net.conv("quant_conv", net.conv("encoder.conv_out", x, padding=1))[:, :4]


def double_size(x):
    return x.repeat_interleave(2, -1).repeat_interleave(2, -2)


def decode(net, latents):
    x = net.conv("decoder.conv_in", net.conv("post_quant_conv", latents), padding=1)
    x = middle(net, "decoder.mid", x)
    for level in (3, 2, 1, 0):
        for k in range(3):
            x = residual(net, f"decoder.up.{level}.block.{k}", x)
        if level:
            x = net.conv(f"decoder.up.{level}.upsample.conv", double_size(x), padding=1)
    return net.conv("decoder.conv_out", swish(net.norm("decoder.norm_out", x, 1e-6)), padding=1)


# The denoiser.


def half_size(x):
    return (x[..., ::2, ::2] + x[..., 1::2, ::2] + x[..., ::2, 1::2] + x[..., 1::2, 1::2]) / 4


def timed(net, name, x, embedding, resample=lambda x: x):
    inner = net.conv(
        f"{name}.in_layers.2", resample(swish(net.norm(f"{name}.in_layers.0", x, 1e-5))), padding=1
    )
    both = (
        swish(embedding) @ net[f"{name}.emb_layers.1.weight"].T + net[f"{name}.emb_layers.1.bias"]
    )
    scale, shift = both[:, :, None, None].chunk(2, dim=1)
    inner = swish(net.norm(f"{name}.out_layers.0", inner, 1e-5) * (1 + scale) + shift)
    inner = net.conv(f"{name}.out_layers.3", inner, padding=1)
    x = resample(x)
    return inner + (
        net.conv(f"{name}.skip_connection", x) if net.has(f"{name}.skip_connection.weight") else x
    )


def attend(net, name, x):
    n, width = x.shape[:2]
    flat = x.reshape(n, width, -1)
    qkv = torch.einsum(
        "oc,bcl->bol", net[f"{name}.qkv.weight"][..., 0], net.norm(f"{name}.norm", flat, 1e-5)
    )
    qkv = (qkv + net[f"{name}.qkv.bias"][:, None]).reshape(n * HEADS, 3 * width // HEADS, -1)
    q, k, v = qkv.split(width // HEADS, dim=1)
    likeness = torch.softmax(torch.einsum("bct,bcs->bts", q, k) / math.sqrt(width // HEADS), dim=-1)
    attended = torch.einsum("bts,bcs->bct", likeness, v).reshape(n, width, -1)
    out = torch.einsum("oc,bcl->bol", net[f"{name}.proj_out.weight"][..., 0], attended)
    return (flat + out + net[f"{name}.proj_out.bias"][:, None]).reshape(x.shape)


def predict_noise(net, noisy, time, condition):
    """Five levels of two blocks, attention on all but the coarsest, blocks that halve and
    double.
    """
    width = net["time_embed.0.weight"].shape[1]
    angles = time[:, None] * 10_000.0 ** (-torch.arange(width // 2) / (width // 2))
    waves = torch.cat([angles.cos(), angles.sin()], dim=1)
    embedding = swish(waves @ net["time_embed.0.weight"].T + net["time_embed.0.bias"])
    embedding = embedding @ net["time_embed.2.weight"].T + net["time_embed.2.bias"]

    x = net.conv("input_blocks.0.0", torch.cat([noisy, condition], 1), padding=1)
    skips = [x]
    index = 1
    for level in range(LEVELS):
        for _ in range(2):
            x = timed(net, f"input_blocks.{index}.0", x, embedding)
            if level < LEVELS - 1:
                x = attend(net, f"input_blocks.{index}.1", x)
            skips.append(x)
            index += 1
        if level < LEVELS - 1:
            x = timed(net, f"input_blocks.{index}.0", x, embedding, half_size)
            skips.append(x)
            index += 1
    x = attend(net, "middle_block.1", timed(net, "middle_block.0", x, embedding))
    x = timed(net, "middle_block.2", x, embedding)
    for index in range(3 * LEVELS):
        level = LEVELS - 1 - index // 3
        x = timed(net, f"output_blocks.{index}.0", torch.cat([x, skips.pop()], 1), embedding)
        if level < LEVELS - 1:
            x = attend(net, f"output_blocks.{index}.1", x)
        if index % 3 == 2 and level:
            x = timed(
                net,
                f"output_blocks.{index}.{1 if level == LEVELS - 1 else 2}",
                x,
                embedding,
                double_size,
            )
    return net.conv("out.2", swish(net.norm("out.0", x, 1e-5)), padding=1)


# The source's encoder, under the names of its second copy.


def normalise(net, name, x):
    mean, variance, gain, offset = (
        net[f"{name}.{part}"][:, None, None]
        for part in ("running_mean", "running_var", "weight", "bias")
    )
    return (x - mean) / (variance + 1e-5).sqrt() * gain + offset


def encode_condition(net, image):
    x = normalise(
        net, "features.1", functional.conv2d(image, net["features.0.weight"], stride=2, padding=3)
    )
    x = functional.max_pool2d(x.clamp(min=0), 3, 2, 1)
    for layer in range(4, 8):
        for k in range(2):
            name = f"features.{layer}.{k}"
            stride = 2 if layer > 4 and k == 0 else 1
            inner = functional.conv2d(x, net[f"{name}.conv1.weight"], stride=stride, padding=1)
            inner = normalise(net, f"{name}.bn1", inner).clamp(min=0)
            inner = normalise(
                net, f"{name}.bn2", functional.conv2d(inner, net[f"{name}.conv2.weight"], padding=1)
            )
            if stride == 2:
                x = normalise(
                    net,
                    f"{name}.downsample.1",
                    functional.conv2d(x, net[f"{name}.downsample.0.weight"], stride=2),
                )
            x = (inner + x).clamp(min=0)
    for name in ("deconv1", "deconv2"):
        x = functional.conv_transpose2d(
            x.clamp(min=0), net[f"{name}.weight"], net[f"{name}.bias"], stride=2, padding=1
        )
    return x
