"""The paper's touch to touch: latent diffusion, told the source's touch by what an encoder sees of it.

The parts lie under the names of the published checkpoint: `first_stage_model` (autoencoder), `cond_stage_model` (the
encoder of the source's touch), `model.diffusion_model` (denoiser) and `scale_factor`, which brings latents to spread 1.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from pipeline.base.arrays import Doubles
from pipeline.networks.autoencoder_kl import LATENT_CHANNELS, AutoencoderKl, sample_latents
from pipeline.networks.condition_encoder import ConditionEncoder
from pipeline.networks.latent_unet import LatentUnet

N_TIMESTEPS = 1000
BETA_RANGE = 0.0015, 0.0155  # of the first and the last time; their roots rise evenly
LATENT_LIMIT = 5.0  # latents of spread 1 beyond this are none of the data's


TrainedPart = Literal["both", "autoencoder", "denoiser"]


class LatentTrainingOutput(NamedTuple):
    """What a step of training is judged by; None for a part that does not learn."""

    reconstruction: Tensor | None  # the target's picture, through the autoencoder
    mean: Tensor  # of its latents
    log_variance: Tensor
    predicted_noise: Tensor | None  # (n, 4, ...) as it was held for, and
    true_noise: Tensor  # as it was


class LatentDiffusion(nn.Module):
    """Three-channel pictures in -1..1 of side `side`; the numbers that come as they are are the paper's.

    `raw_condition`: it was taught on changes of 0..255 where the spread is that of 0..1, as the published weights were.
    `half_turn`: its pictures are to be turned by half a turn for the target's camera. `made_*` and `true_*` are mean
    and spread in mm of generated and true imprints over what it learned from, by which small biases are taken out; a
    spread of 0 leaves that out.
    """

    model: nn.ModuleDict
    scale_factor: Tensor
    alphas_cumprod: Tensor

    def __init__(
        self, *, side: int = 256, width: int = 192, channel_multipliers: str = "1 2 2 4 4", blocks: int = 2,
        attention: str = "1 2 4 8", heads: int = 8, groups: int = 32, autoencoder_width: int = 128,
        autoencoder_multipliers: str = "1 2 4 4", autoencoder_blocks: int = 2, condition_channels: int = 64, raw_condition: bool = False,
        half_turn: bool = False, generated_mean_mm: float = 0.0, generated_std_mm: float = 0.0, true_mean_mm: float = 0.0,
        true_std_mm: float = 0.0,
    ) -> None:  # fmt: skip
        super().__init__()
        self.side, self.raw_condition, self.half_turn = side, bool(raw_condition), bool(half_turn)
        self.generated_stats, self.true_stats = (generated_mean_mm, generated_std_mm), (true_mean_mm, true_std_mm)
        self.first_stage_model = AutoencoderKl(
            width=autoencoder_width, times=_numbers(autoencoder_multipliers), blocks=autoencoder_blocks, groups=groups
        )
        self.cond_stage_model = ConditionEncoder(width=condition_channels)
        self.model = nn.ModuleDict({"diffusion_model": LatentUnet(
            inputs=LATENT_CHANNELS + condition_channels, width=width, channel_multipliers=_numbers(channel_multipliers), blocks=blocks, attention=_numbers(attention),
            heads=heads, groups=groups,
        )})  # fmt: skip
        self.register_buffer("scale_factor", torch.tensor(1.0))
        self.register_buffer("alphas_cumprod", torch.tensor(compute_alphas_cumprod().tolist()), persistent=False)

    def forward(
        self,
        target: Tensor,
        source: Tensor,
        time: Tensor,
        has_condition: Tensor,
        noises: Tensor,
        part: TrainedPart = "both",
    ) -> LatentTrainingOutput:
        """For training: pictures of both, times (n,), whether each is told its source (n,), noise (2, n, 4, ...).

        Its parts may learn one after the other: the autoencoder as it is when the denoiser does.
        """
        with torch.set_grad_enabled(torch.is_grad_enabled() and part != "denoiser"):
            mean, log_variance = self.first_stage_model.encode(target)
            latents = sample_latents(mean, log_variance, noises[0])
            rebuilt = None if part == "denoiser" else self.first_stage_model.decode(latents)
        if self.training and part != "denoiser":
            self._follow_spread(latents.detach().float())
        if part == "autoencoder":
            return LatentTrainingOutput(
                reconstruction=rebuilt, mean=mean, log_variance=log_variance, predicted_noise=None, true_noise=noises[1]
            )
        left = self.alphas_cumprod[time][:, None, None, None]
        noisy = left.sqrt() * self.scale_factor * latents.detach() + (1 - left).sqrt() * noises[1]
        shown = self.cond_stage_model(source) * has_condition[:, None, None, None]
        held = self.model["diffusion_model"](torch.cat([noisy, shown], dim=1), time)
        return LatentTrainingOutput(
            reconstruction=rebuilt, mean=mean, log_variance=log_variance, predicted_noise=held, true_noise=noises[1]
        )

    def predict_noise(self, noisy: Tensor, time: Tensor, shown: Tensor) -> Tensor:
        """What it holds the noise for, of latents as they are at that time."""
        return self.model["diffusion_model"](torch.cat([noisy, shown], dim=1), time)

    def decode_images(self, latents: Tensor) -> Tensor:
        """Pictures (n, 3, side, side) in -1..1 of latents of spread 1."""
        return self.first_stage_model.decode(latents / self.scale_factor)

    def _follow_spread(self, latents: Tensor) -> None:
        """The scale that brings latents to spread 1, followed while the autoencoder still changes."""
        with torch.no_grad():
            self.scale_factor.lerp_(1.0 / latents.std().clamp(min=1e-3), 0.1)


def compute_alphas_cumprod() -> Doubles:
    """(TIMES,) share of the signal's power that is left at each time."""
    roots = np.linspace(BETA_RANGE[0] ** 0.5, BETA_RANGE[1] ** 0.5, N_TIMESTEPS)
    return np.cumprod(1.0 - roots**2)


def _numbers(words: str) -> tuple[int, ...]:
    return tuple(int(word) for word in words.split())
