"""The paper's generator: latent diffusion conditioned on the encoded source image (T2T) or target
depth (T2D2).

Parts and tensors have the names of the published checkpoint: `first_stage_model` (autoencoder),
`cond_stage_model` (encoder of the condition), `model.diffusion_model` (denoiser) and
`scale_factor`, which scales latents to unit standard deviation.
"""

from collections import OrderedDict
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from pipeline.core.arrays import Doubles
from pipeline.stages.networks.autoencoder_kl import LATENT_CHANNELS, AutoencoderKl, sample_latents
from pipeline.stages.networks.latent_unet import LatentUnet

N_TIMESTEPS = 1000
BETA_RANGE = 0.0015, 0.0155  # first and last beta; their square roots are evenly spaced
LATENT_LIMIT = 5.0  # standard deviations; latents of the data stay within

_DOWNSAMPLING = 8  # image pixels per latent, along each side
TrainedPart = Literal["both", "autoencoder", "denoiser"]
EncoderKind = Literal["resnet", "fold"]
"""How a condition enters the latents' grid: encoded, as published, or its pixels folded into
channels.
"""
Condition = Literal["image", "reprojected", "depth"]
"""What the network is conditioned on: the source's image as published, the source's image resampled
to the target's view, or the target depth.
"""


class LatentTrainingOutput(NamedTuple):
    """Outputs of a training step; None for a part that is not trained."""

    reconstruction: Tensor | None  # target image through the autoencoder
    mean: Tensor  # of the latents
    log_variance: Tensor
    predicted_noise: Tensor | None  # (n, 4, ...)
    true_noise: Tensor


class LatentDiffusion(nn.Module):
    """Latent diffusion of three-channel images in -1..1 of side `side`.

    Defaults are those of the paper.

    `condition` (`stages.touch.image_condition`, `stages.touch.t2d2`) has
    `condition_inputs` channels, which `condition_encoder` brings to the latents' grid; only
    "resnet" has `condition_channels`. `raw_condition`: trained on changes of 0..255 normalised by
    statistics of 0..1, as the published weights were. `half_turn`: the output has to be rotated by
    180 degrees for the target's camera. `leading_times`: sampled at those of the published sampler.
    `trained_with_condition_dropout`: whether guidance can act. `trained_on_recordings` (0 or 1): by
    recorded pairs, which know how the sensors lie.
    """

    model: nn.ModuleDict
    scale_factor: Tensor
    alphas_cumprod: Tensor

    def __init__(
        self,
        *,
        side: int = 256,
        width: int = 192,
        channel_multipliers: str = "1 2 2 4 4",
        blocks: int = 2,
        attention: str = "1 2 4 8",
        heads: int = 8,
        groups: int = 32,
        autoencoder_width: int = 128,
        autoencoder_multipliers: str = "1 2 4 4",
        autoencoder_blocks: int = 2,
        condition_channels: int = 64,
        condition: Condition = "image",
        condition_inputs: int = 3,
        condition_encoder: EncoderKind = "resnet",
        raw_condition: bool = False,
        trained_with_condition_dropout: bool = True,
        half_turn: bool = False,
        leading_times: bool = False,
        trained_on_recordings: float = 0.0,
    ) -> None:
        super().__init__()
        self.side = side
        self.condition = condition
        self.half_turn = bool(half_turn)
        self.leading_times = bool(leading_times)
        self.raw_condition = bool(raw_condition)
        self.trained_on_recordings = bool(trained_on_recordings)
        self.trained_with_condition_dropout = bool(trained_with_condition_dropout)
        self.first_stage_model = AutoencoderKl(
            width=autoencoder_width,
            channel_multipliers=_parse_integers(autoencoder_multipliers),
            blocks=autoencoder_blocks,
            groups=groups,
        )
        self.cond_stage_model: nn.Module = nn.PixelUnshuffle(_DOWNSAMPLING)
        if condition_encoder == "resnet":
            self.cond_stage_model = make_condition_encoder(condition_channels, condition_inputs)
        else:
            condition_channels = condition_inputs * _DOWNSAMPLING**2
        self.model = nn.ModuleDict(
            {
                "diffusion_model": LatentUnet(
                    inputs=LATENT_CHANNELS + condition_channels,
                    outputs=LATENT_CHANNELS,
                    width=width,
                    channel_multipliers=_parse_integers(channel_multipliers),
                    blocks=blocks,
                    attention=_parse_integers(attention),
                    heads=heads,
                    groups=groups,
                )
            }
        )
        self.register_buffer("scale_factor", torch.tensor(1.0))
        self.register_buffer(
            "alphas_cumprod", torch.tensor(compute_alphas_cumprod().tolist()), persistent=False
        )

    def forward(
        self,
        target: Tensor,
        source: Tensor,
        time: Tensor,
        has_condition: Tensor,
        noises: Tensor,
        part: TrainedPart = "both",
    ) -> LatentTrainingOutput:
        """Training step: target and condition images, times (n,), conditioning flags (n,), noise
        (2, n, 4, ...).

        A target of 8 channels is the mean and log variance of its latents, which trains a denoiser
        faster. With `part` only the autoencoder or only the denoiser is trained.
        """
        with torch.set_grad_enabled(torch.is_grad_enabled() and part != "denoiser"):
            is_encoded = target.shape[1] == 2 * LATENT_CHANNELS
            mean, log_variance = (
                target.chunk(2, dim=1) if is_encoded else self.first_stage_model.encode(target)
            )
            latents = sample_latents(mean, log_variance, noises[0])
            decoded = None if part == "denoiser" else self.first_stage_model.decode(latents)
        if self.training and part != "denoiser":
            self._update_scale_factor(latents.detach().float())
        predicted = None
        if part != "autoencoder":
            alpha = self.alphas_cumprod[time][:, None, None, None]
            noisy = (
                alpha.sqrt() * self.scale_factor * latents.detach() + (1 - alpha).sqrt() * noises[1]
            )
            condition = self.cond_stage_model(source) * has_condition[:, None, None, None]
            predicted = self.predict_noise(noisy, time, condition)
        return LatentTrainingOutput(
            reconstruction=decoded,
            mean=mean,
            log_variance=log_variance,
            predicted_noise=predicted,
            true_noise=noises[1],
        )

    def predict_noise(self, noisy: Tensor, time: Tensor, condition: Tensor) -> Tensor:
        """Predicted noise of latents at a time, given the encoded condition."""
        return self.model["diffusion_model"](torch.cat([noisy, condition], dim=1), time)

    def decode_images(self, latents: Tensor) -> Tensor:
        """Images (n, 3, side, side) in -1..1 from latents of unit standard deviation."""
        return self.first_stage_model.decode(latents / self.scale_factor)

    def _update_scale_factor(self, latents: Tensor) -> None:
        """Update the running scale that brings latents to unit standard deviation."""
        with torch.no_grad():
            self.scale_factor.lerp_(1.0 / latents.std().clamp(min=1e-3), 0.1)


def compute_alphas_cumprod() -> Doubles:
    """(N_TIMESTEPS,) share of the signal's power that remains at each time."""
    roots = np.linspace(BETA_RANGE[0] ** 0.5, BETA_RANGE[1] ** 0.5, N_TIMESTEPS)
    return np.cumprod(1.0 - roots**2)


def _parse_integers(text: str) -> tuple[int, ...]:
    return tuple(int(word) for word in text.split())


def make_condition_encoder(width: int = 64, inputs: int = 3) -> nn.Module:
    """Features (n, width, side / 8, side / 8) of images (n, inputs, side, side).

    ResNet-18 (He et al. 2016) without its classifier, then two steps of enlargement.
    Published are 64 of 3 inputs.
    """
    resnet = OrderedDict[str, nn.Module](
        conv1=nn.Conv2d(inputs, width, 7, 2, 3, bias=False),
        bn1=nn.BatchNorm2d(width),
        relu=nn.ReLU(),
        pool=nn.MaxPool2d(3, 2, 1),
    )
    narrow = width
    for level in range(4):
        wide = width * 2**level
        blocks = _Basic(narrow, wide, 2 if level else 1), _Basic(wide, wide, 1)
        resnet[f"layer{level + 1}"] = nn.Sequential(*blocks)
        narrow = wide
    return nn.Sequential(
        OrderedDict(
            resnet=nn.Sequential(resnet),
            relu1=nn.ReLU(),
            deconv1=nn.ConvTranspose2d(8 * width, 4 * width, 4, 2, 1),
            relu2=nn.ReLU(),
            deconv2=nn.ConvTranspose2d(4 * width, width, 4, 2, 1),
        )
    )


class _Basic(nn.Module):
    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.downsample = nn.Sequential()
        if inputs != outputs:
            self.downsample.append(nn.Conv2d(inputs, outputs, 1, stride, bias=False))
            self.downsample.append(nn.BatchNorm2d(outputs))

    def forward(self, field: Tensor) -> Tensor:
        inner = self.bn2(self.conv2(self.bn1(self.conv1(field)).relu()))
        return (inner + self.downsample(field)).relu()
