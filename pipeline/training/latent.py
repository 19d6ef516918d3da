"""To make one sensor's touch of another's picture by latent diffusion: the paper's touch to touch.

Autoencoder, encoder of the source and denoiser learn at once: the denoiser is shown latents that do not feel it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.base.params import setting
from pipeline.networks.square_images import SIDE, decode_image, encode_image, normalise
from pipeline.training.touch_squares import TouchSquares, simulate_touch_squares
from pipeline.training.vqvae import Direction

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.task import Example, Split

TrainedPart = Literal["both", "autoencoder", "denoiser"]
_HELD_OUT_SEED, _LATENT, _SMALLER, _TIMES = 7, 4, 8, 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class LatentTask:
    """How examples are made, and what counts for how much."""

    direction: Direction = setting("gel_to_bubble", "Direction", choices=Direction)
    n_presses: int = setting(2000, "Presses", low=1, high=10_000_000, help="that all examples are drawn from")
    press_seed: int = setting(1, "Seed of the presses", low=0, high=2**31 - 1)
    folder: str = setting("", "Folder", help="keeps the presses for other runs; empty = worked out each time")
    side: int = setting(SIDE, "Side", unit="px", low=32, high=512, step=32, help="of the pictures; the paper's is 256")
    trained_part: TrainedPart = setting(
        "both",
        "What learns",
        choices=TrainedPart,
        help="the autoencoder may learn before the denoiser, which is quicker",
    )
    condition_dropout: float = setting(
        0.1, "Share without their source", low=0.0, high=1.0, help="what guidance starts from"
    )
    reconstruction_weight: float = setting(4.0, "Weight of the autoencoder", low=0.0, high=100.0)
    kl_weight: float = setting(1e-4, "Weight of the latents' spread", low=0.0, high=100.0)

    def sample(self, rng: np.random.Generator) -> Example:
        """Pictures of both sides of a touch; noise and its time are drawn with the loss."""
        return self._example(
            simulate_touch_squares("learned", self.press_seed, int(rng.integers(self.n_presses)), self.folder)
        )

    def make_validation_example(self, split: Split, index: int) -> Example:
        """Of a training object as it was never held, or of a tool that is never learned from, with noise of its own."""
        rng, small = np.random.default_rng([5, index]), self.side // _SMALLER
        return {
            **self._example(simulate_touch_squares(split, _HELD_OUT_SEED, index, self.folder)),
            "time": np.array([rng.integers(_TIMES)], np.float32),
            "noises": rng.standard_normal((2, _LATENT, small, small)).astype(np.float32),
        }

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """Mean absolute errors of the rebuilt picture and of the noise, and how far latents are from unit normal."""
        import torch

        n, small, device = len(batch["target"]), batch["target"].shape[-1] // _SMALLER, batch["target"].device
        time, told = (
            torch.randint(_TIMES, (n,)).to(device),
            (torch.rand(n) >= self.condition_dropout).float().to(device),
        )
        noises = torch.randn(2, n, _LATENT, small, small).to(device)
        found = network(batch["target"], batch["source"], time, told, noises, self.trained_part)
        parts: dict[str, Tensor] = {}
        if found.predicted_noise is not None:
            parts["noise"] = (found.predicted_noise - found.true_noise).abs().mean()
        if found.reconstruction is not None:
            parts["rebuilt"] = (found.reconstruction - batch["target"]).abs().mean()
            parts["spread"] = 0.5 * (found.mean**2 + found.log_variance.exp() - 1.0 - found.log_variance).mean()
        weights = {"noise": 1.0, "rebuilt": self.reconstruction_weight, "spread": self.kl_weight}
        loss = torch.stack([weights[name] * value for name, value in parts.items()]).sum()
        return loss, {name: value.detach() for name, value in parts.items()}

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """How well pictures come through the autoencoder, and how well noise is told."""
        import torch

        kind = "bubble" if self.direction == "gel_to_bubble" else "gel"
        unit, times = ("mm", 1.0) if kind == "bubble" else ("grey", 255.0)
        rows: list[tuple[float, float]] = []
        for one in held_out:
            batch = {name: torch.from_numpy(np.array(a)[None]) for name, a in one.items()}
            with torch.inference_mode():
                noises = batch["noises"].transpose(0, 1)
                told = torch.ones(1)
                found = network(batch["target"], batch["source"], batch["time"][:, 0].long(), told, noises)
            rebuilt, truth = (decode_image(a, kind) for a in (found.reconstruction[0].numpy(), one["target"]))
            off = (found.predicted_noise - found.true_noise).abs().mean()
            rows.append((times * float(np.abs(rebuilt - truth).mean()), float(off)))
        names = (f"rebuilt, {unit}", "noise")
        return dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True))

    def _example(self, touch: TouchSquares) -> Example:
        if self.direction == "gel_to_bubble":
            source, target = normalise(touch.gel_change, "gel"), encode_image(touch.exact_imprint_mm, "bubble")
        else:
            source, target = (
                np.repeat(normalise(touch.bubble_imprint_mm, "bubble"), 3, axis=0),
                encode_image(touch.nominal_gel_change, "gel"),
            )
        return {"source": _sized(source, self.side), "target": _sized(target, self.side)}


def _sized(square: Any, side: int) -> Any:
    """The same square with other pixels."""
    import cv2

    if square.shape[-1] == side:
        return square
    return np.stack([cv2.resize(channel, (side, side), interpolation=cv2.INTER_CUBIC) for channel in square])
