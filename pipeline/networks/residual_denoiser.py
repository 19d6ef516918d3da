"""A compact denoiser of residuals: what is to be added to a first answer, seen through noise, given a condition.

A U-Net like `compact_unet` that also hears how strong the noise is: every block scales and shifts what it has
normalised by functions of log sigma. Everything is in units of `unit_mm` and told as in `samplers`: noisy = clean +
sigma * noise. Three things may be predicted, all turned into the clean field here: the field itself, the noise, or
v, a mixture of both (Salimans and Ho 2022). The noise is as smooth as `smooth` says (`smooth_noise`). At the strongest
one nothing can be seen, and nothing is shown: the first step, and an answer in one, rest on the condition alone. A last
channel says how far off the clean field is expected, `doubts` how many times as far off it has to be taken for where a
source felt and beyond, so that what is held back by it betters what it begins with; `doubt_power` how much faster that
grows than what is told: by 2, half as much told counts a quarter. Of a source that is coarser than the target, in its
own pixels: `blur_px` how wide an edge has to be drawn, the middle of all places where it may be, and `reach_px` how far
contact goes beyond the middles of those pixels that told it.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Literal, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

PredictionTarget = Literal["clean", "v", "noise"]
FIELD_CHANNELS = 2  # channels that are denoised: indentation and contact
FIELD_LIMIT = 8.0  # units: no clean field goes beyond
_WAVES = 16
_HEARD = 64


class ResidualDenoiser(nn.Module):
    """(clean field, log of its expected error) (n, STATES + 1, rows, cols), from a noisy field and its condition."""

    def __init__(
        self, *, inputs: int, unit_mm: float, base_channels: int = 32, levels: int = 4, max_channels: int = 112, fold: int = 2,
        sigma_max: float = 200.0, sigma_min: float = 0.02, prediction: PredictionTarget = "clean", noise_correlation: float = 0.0,
        error_factor_in_view: float = 1.0, error_factor_outside: float = 1.0, error_exponent: float = 1.0, blur_px: float = 0.0,
        contact_margin_px: float = 0.0,
    ) -> None:  # fmt: skip
        super().__init__()
        if prediction not in ("clean", "v", "noise"):
            raise ValueError(f"prediction must be clean, v or noise, got {prediction!r}")
        self.unit_mm, self.sigma_max, self.sigma_min, self.prediction = unit_mm, sigma_max, sigma_min, prediction
        self.inputs, self.fold, self.field_limit, self.noise_correlation = inputs, fold, FIELD_LIMIT, noise_correlation
        self.error_factors, self.error_exponent = (error_factor_in_view, error_factor_outside), error_exponent
        self.blur_px, self.contact_margin_px = blur_px, contact_margin_px
        widths = [min(base_channels * 2**level, max_channels) for level in range(levels)]
        self.noise_embedding = nn.Sequential(
            nn.Linear(2 * _WAVES, _HEARD), nn.SiLU(), nn.Linear(_HEARD, _HEARD), nn.SiLU()
        )
        self.start = _Block((inputs + FIELD_CHANNELS) * fold * fold, widths[0])
        self.down = nn.ModuleList(_Pair(narrow, wide) for narrow, wide in pairwise(widths))
        self.thin = nn.ModuleList(nn.Conv2d(wide, narrow, 1) for narrow, wide in pairwise(widths))
        self.merge = nn.ModuleList(_Block(width, width) for width in widths[:-1])
        self.finish = nn.Conv2d(widths[0], (FIELD_CHANNELS + 1) * fold * fold, 3, padding=1)
        nn.init.zeros_(self.finish.weight)  # it begins by adding nothing
        nn.init.zeros_(cast("Tensor", self.finish.bias))

    def forward(self, noisy: Tensor, sigma: Tensor, condition: Tensor) -> Tensor:
        """Of a batch: noisy (n, STATES, rows, cols), sigma (n,), condition (n, inputs, rows, cols)."""
        level = sigma.reshape(-1, 1, 1, 1)
        seen = torch.where(level < self.sigma_max, noisy / torch.sqrt(1.0 + level**2), torch.zeros_like(noisy))
        answer = self._network(torch.cat([seen, condition], 1), self.noise_embedding(_waves(sigma))).float()
        said = answer[:, :FIELD_CHANNELS]
        if self.prediction == "noise":
            said = noisy - level * said
        elif self.prediction == "v":
            said = seen / torch.sqrt(1.0 + level**2) - level / torch.sqrt(1.0 + level**2) * said
        return torch.cat([said.clamp(-FIELD_LIMIT, FIELD_LIMIT), answer[:, FIELD_CHANNELS:]], 1)

    def _network(self, picture: Tensor, heard: Tensor) -> Tensor:
        rows, cols = picture.shape[-2:]
        beyond = (0, -cols % self.fold, 0, -rows % self.fold)
        whole = functional.pad(picture, beyond, mode="replicate") if any(beyond) else picture
        seen = [cast("Tensor", self.start(functional.pixel_unshuffle(whole, self.fold), heard))]
        for down in self.down:
            seen.append(down(functional.max_pool2d(seen[-1], 2, ceil_mode=True), heard))
        field = seen.pop()
        for thin, merge in zip(reversed(self.thin), reversed(self.merge), strict=True):
            beside = seen.pop()
            field = functional.interpolate(thin(field), size=beside.shape[-2:], mode="bilinear", align_corners=False)
            field = merge(beside + field, heard)
        return functional.pixel_shuffle(self.finish(field), self.fold)[..., :rows, :cols]


class _Block(nn.Module):
    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.filter = nn.Conv2d(inputs, outputs, 3, padding=1, bias=False)
        self.norm = nn.BatchNorm2d(outputs)
        self.modulation = nn.Linear(_HEARD, 2 * outputs)
        nn.init.zeros_(self.modulation.weight)
        nn.init.zeros_(self.modulation.bias)

    def forward(self, field: Tensor, heard: Tensor) -> Tensor:
        scale, shift = self.modulation(heard).chunk(2, 1)
        if not self.training and len(field) == 1:
            return self._at_once(field, 1.0 + scale[0], shift[0])
        normed = self.norm(self.filter(field))
        return functional.relu(torch.addcmul(shift[..., None, None], normed, 1.0 + scale[..., None, None]))

    def _at_once(self, field: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
        """The same of one field, all that follows the filter taken into it: a pass over the field costs as much."""
        norm = self.norm
        assert norm.running_var is not None
        assert norm.running_mean is not None
        gain = norm.weight * torch.rsqrt(norm.running_var + norm.eps)
        weight = self.filter.weight * (scale * gain)[:, None, None, None]
        bias = shift + scale * (norm.bias - norm.running_mean * gain)
        return functional.relu(functional.conv2d(field, weight, bias, padding=1))


class _Pair(nn.Module):
    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.first, self.second = _Block(inputs, outputs), _Block(outputs, outputs)

    def forward(self, field: Tensor, heard: Tensor) -> Tensor:
        return self.second(self.first(field, heard), heard)


def _waves(sigma: Tensor) -> Tensor:
    """(n, 2 waves) of log sigma."""
    phase = torch.log(sigma)[:, None] * (0.25 * 1.35 ** torch.arange(_WAVES, device=sigma.device))
    return torch.cat([phase.sin(), phase.cos()], 1)
