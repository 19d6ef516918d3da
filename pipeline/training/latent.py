"""Task: another sensor's image by latent diffusion, the paper's touch to touch.

Autoencoder, condition encoder and denoiser are trained at once; the denoiser's gradient does not reach the latents.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.base.params import setting
from pipeline.networks.square_images import SIDE, decode_image, encode_image, normalise
from pipeline.training.task import VALIDATION_SEED, folder_setting, presses_setting, seed_setting
from pipeline.training.touch_squares import Direction, TouchSquares, simulate_touch_squares
from pipeline.training.vqvae import METRIC_UNITS

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.task import Example, Split

TrainedPart = Literal["both", "autoencoder", "denoiser"]
_LATENT_CHANNELS, _LATENT_DOWNSAMPLING, _N_TIMES = 4, 8, 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class LatentTask:
    """Settings of the examples and weights of the loss."""

    direction: Direction = setting("gel_to_bubble", "Direction", choices=Direction)
    n_presses: int = presses_setting()
    press_seed: int = seed_setting()
    folder: str = folder_setting()
    side: int = setting(SIDE, "Image side", unit="px", low=32, high=512, step=32, help="256 in the paper")
    trained_part: TrainedPart = setting(
        "both", "Trained part", choices=TrainedPart, help="training the autoencoder before the denoiser is faster"
    )
    condition_dropout: float = setting(
        0.1, "Condition dropout", low=0.0, high=1.0, help="examples without a source, for guidance"
    )
    reconstruction_weight: float = setting(4.0, "Reconstruction weight", low=0.0, high=100.0)
    kl_weight: float = setting(1e-4, "KL weight", low=0.0, high=100.0)

    def sample(self, rng: np.random.Generator) -> Example:
        """Images of both sides of a touch; noise and time are sampled with the loss."""
        index = int(rng.integers(self.n_presses))
        return self._make_example(simulate_touch_squares("training", self.press_seed, index, self.folder))

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A training object in a new pose, or an unseen tool; with its own time and noise."""
        rng, side = np.random.default_rng([5, index]), self.side // _LATENT_DOWNSAMPLING
        return {
            **self._make_example(simulate_touch_squares(split, VALIDATION_SEED, index, self.folder)),
            "time": np.array([rng.integers(_N_TIMES)], np.float32),
            "noises": rng.standard_normal((2, _LATENT_CHANNELS, side, side)).astype(np.float32),
        }

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """Mean absolute errors of reconstruction and noise, and KL divergence of the latents from a unit normal."""
        import torch

        n, device = len(batch["target"]), batch["target"].device
        side = batch["target"].shape[-1] // _LATENT_DOWNSAMPLING
        time = torch.randint(_N_TIMES, (n,)).to(device)
        has_condition = (torch.rand(n) >= self.condition_dropout).float().to(device)
        noises = torch.randn(2, n, _LATENT_CHANNELS, side, side).to(device)
        output = network(batch["target"], batch["source"], time, has_condition, noises, self.trained_part)
        terms: dict[str, Tensor] = {}
        if output.predicted_noise is not None:
            terms["noise"] = (output.predicted_noise - output.true_noise).abs().mean()
        if output.reconstruction is not None:
            terms["reconstruction"] = (output.reconstruction - batch["target"]).abs().mean()
            terms["kl"] = 0.5 * (output.mean**2 + output.log_variance.exp() - 1.0 - output.log_variance).mean()
        weights = {"noise": 1.0, "reconstruction": self.reconstruction_weight, "kl": self.kl_weight}
        loss = torch.stack([weights[name] * value for name, value in terms.items()]).sum()
        return loss, {name: value.detach() for name, value in terms.items()}

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Mean absolute errors of the autoencoder's reconstruction and of the predicted noise."""
        import torch

        kind: str = "bubble" if self.direction == "gel_to_bubble" else "gel"
        unit, factor = METRIC_UNITS[kind]
        rows: list[tuple[float, float]] = []
        for example in held_out:
            batch = {name: torch.from_numpy(np.array(a)[None]) for name, a in example.items()}
            time, noises = batch["time"][:, 0].long(), batch["noises"].transpose(0, 1)
            with torch.inference_mode():
                output = network(batch["target"], batch["source"], time, torch.ones(1), noises)
            images = (decode_image(a, kind) for a in (output.reconstruction[0].numpy(), example["target"]))
            reconstruction = factor * float(np.abs(np.subtract(*images)).mean())
            rows.append((reconstruction, float((output.predicted_noise - output.true_noise).abs().mean())))
        names = (f"reconstruction error, {unit}", "noise error")
        return dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True))

    def _make_example(self, touch: TouchSquares) -> Example:
        source, source_kind, target, target_kind = touch.get_pair(self.direction)
        source = normalise(source, source_kind)
        if source_kind == "bubble":
            source = np.repeat(source, 3, axis=0)
        return {"source": _resize(source, self.side), "target": _resize(encode_image(target, target_kind), self.side)}


def _resize(square: Any, side: int) -> Any:
    import cv2

    if square.shape[-1] == side:
        return square
    return np.stack([cv2.resize(channel, (side, side), interpolation=cv2.INTER_CUBIC) for channel in square])
