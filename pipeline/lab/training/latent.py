"""Task: a target's image by latent diffusion, the paper's touch to touch and touch to depth to
touch.

Autoencoder, condition encoder and denoiser are trained at once or one after the other; the
denoiser's gradient does not reach the latents.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.core.arrays import Floats
from pipeline.core.errors import SettingProblem
from pipeline.core.params import setting
from pipeline.lab.training.condition_squares import SquareRequest
from pipeline.lab.training.denoising import TargetSensor
from pipeline.lab.training.distributed import unwrap_network
from pipeline.lab.training.recorded_pairs import RecordedPair
from pipeline.lab.training.task import VALIDATION_SEED, SimulatedPresses, augmentation_setting
from pipeline.lab.training.touch_squares import list_pair_sensors, read_square_pair
from pipeline.sensors.kinds import get_kind
from pipeline.sensors.spec import load_sensor
from pipeline.stages.networks import network_factory
from pipeline.stages.networks.touch_formats import SIDE, decode_image, encode_image
from pipeline.stages.networks.weights import load_weights
from pipeline.stages.touch.latent_diffusion import build_image_square

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.lab.training.task import Example, Split

Condition = Literal["image", "reprojected", "depth"]
TrainedPart = Literal["both", "autoencoder", "denoiser"]
_LATENT_CHANNELS = 4
_LATENT_DOWNSAMPLING = 8
_N_TIMES = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class LatentTask(SimulatedPresses):
    """Settings of the examples and weights of the loss."""

    target: TargetSensor = setting("soft_bubble", "Target", choices=TargetSensor)
    condition: Condition = setting(
        "image",
        "Condition",
        choices=Condition,
        help="must equal `condition` of the network; image in the paper's T2T",
    )
    augmentation_share: float = augmentation_setting()
    side: int = setting(
        SIDE, "Image side", unit="px", low=32, high=512, step=32, help="256 in the paper"
    )
    trained_part: TrainedPart = setting(
        "both",
        "Trained part",
        choices=TrainedPart,
        help="training the autoencoder before the denoiser is faster",
    )
    autoencoder: str = setting(
        "",
        "Autoencoder",
        help="weights that encode every target once, to train a denoiser; empty = in every step",
    )
    condition_dropout: float = setting(
        0.1,
        "Condition dropout",
        low=0.0,
        high=1.0,
        help="examples without a condition, for guidance",
    )
    reconstruction_weight: float = setting(4.0, "Reconstruction weight", low=0.0, high=100.0)
    kl_weight: float = setting(1e-4, "KL weight", low=0.0, high=100.0)

    @property
    def kind(self) -> str:
        """Kind of the target."""
        return load_sensor(self.target).kind

    def sample(self, rng: np.random.Generator) -> Example:
        """The condition and the target's image; noise and time are sampled with the loss."""
        index = int(rng.integers(self.n_presses))
        augmented = bool(rng.random() < self.augmentation_share)
        made = self._request.make_example("training", self.press_seed, index, rng, augmented)
        condition = made[0]
        target = encode_image(made[1], self.kind)
        return {
            "source": condition,
            "target": _encode(self.autoencoder, target) if self.autoencoder else target,
        }

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A training object in a new pose, or an unseen tool; with its own time and noise."""
        rng = np.random.default_rng([5, index])
        condition, target = self._request.make_example(split, VALIDATION_SEED, index, rng)
        return self._add_noise(
            {"source": condition, "target": encode_image(target, self.kind)}, rng
        )

    @property
    def _request(self) -> SquareRequest:
        return SquareRequest(
            target=self.target, condition=self.condition, side=self.side, folder=self.folder
        )

    @property
    def pair_sensors(self) -> tuple[str, str]:
        """Names of source and target.

        Raises SettingProblem where the target's depth is the condition.
        """
        if self.condition == "depth":
            raise SettingProblem(
                "touch to depth to touch trains on the target's touches alone, not on pairs"
            )
        return list_pair_sensors(self.target)

    def prepare_pair(self, pair: RecordedPair) -> Example:
        """Condition and target image of a recorded touch."""
        squares = read_square_pair(pair, self.side)
        condition = build_image_square(
            squares.source, self.condition, pair.source, pair.target, pair.alignment
        )
        return {
            "source": np.array(condition, np.float32),
            "target": encode_image(squares.target, self.kind),
        }

    def make_pair_example(
        self, prepared: Example, rng: np.random.Generator, *, is_validation: bool
    ) -> Example:
        """The arrays of a simulated example."""
        if is_validation:
            return self._add_noise(prepared, rng)
        target = prepared["target"]
        return {
            **prepared,
            "target": _encode(self.autoencoder, target) if self.autoencoder else target,
        }

    def _add_noise(self, example: Example, rng: np.random.Generator) -> Example:
        """The example with a time and noise, so that every validation is of the same ones."""
        side = self.side // _LATENT_DOWNSAMPLING
        return {
            **example,
            "time": np.array([rng.integers(_N_TIMES)], np.float32),
            "noises": rng.standard_normal((2, _LATENT_CHANNELS, side, side)).astype(np.float32),
        }

    def compute_loss(
        self, network: nn.Module, batch: Mapping[str, Tensor]
    ) -> tuple[Tensor, dict[str, Any]]:
        """Mean absolute errors of reconstruction and noise, and KL divergence of the latents
        from a unit normal.
        """
        import torch

        if unwrap_network(network).condition != self.condition:
            raise SettingProblem("condition must be the same in [network] and in [settings]")
        n = len(batch["target"])
        device = batch["target"].device
        side = self.side // _LATENT_DOWNSAMPLING
        time = torch.randint(_N_TIMES, (n,)).to(device)
        has_condition = (torch.rand(n) >= self.condition_dropout).float().to(device)
        noises = torch.randn(2, n, _LATENT_CHANNELS, side, side).to(device)
        output = network(
            batch["target"], batch["source"], time, has_condition, noises, self.trained_part
        )
        terms: dict[str, Tensor] = {}
        if output.predicted_noise is not None:
            terms["noise"] = (output.predicted_noise - output.true_noise).abs().mean()
        if output.reconstruction is not None:
            terms["reconstruction"] = (output.reconstruction - batch["target"]).abs().mean()
            terms["kl"] = (
                0.5
                * (output.mean**2 + output.log_variance.exp() - 1.0 - output.log_variance).mean()
            )
        weights = {"noise": 1.0, "reconstruction": self.reconstruction_weight, "kl": self.kl_weight}
        loss = torch.stack([weights[name] * value for name, value in terms.items()]).sum()
        return loss, {name: value.detach() for name, value in terms.items()}

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Mean absolute errors of the autoencoder's reconstruction and of the predicted noise."""
        import torch

        kind = get_kind(self.kind)
        rows: list[tuple[float, float]] = []
        for example in held_out:
            batch = {name: torch.from_numpy(np.array(a)[None]) for name, a in example.items()}
            time = batch["time"][:, 0].long()
            noises = batch["noises"].transpose(0, 1)
            with torch.inference_mode():
                output = network(batch["target"], batch["source"], time, torch.ones(1), noises)
            images = (
                decode_image(a, kind.key)
                for a in (output.reconstruction[0].numpy(), example["target"])
            )
            reconstruction = kind.full_change * float(np.abs(np.subtract(*images)).mean())
            rows.append(
                (reconstruction, float((output.predicted_noise - output.true_noise).abs().mean()))
            )
        names = (f"reconstruction error, {kind.change_unit}", "noise error")
        return dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True))


def _encode(file: str, target: Floats) -> Floats:
    """(8, side / 8, side / 8): mean and log variance of the latents of an image (3, side, side)
    in -1..1.
    """
    import torch

    with torch.inference_mode():
        moments = _load_autoencoder(file).encode(torch.from_numpy(target.copy())[None])
    return torch.cat(moments, dim=1)[0].numpy()


@lru_cache(maxsize=1)
def _load_autoencoder(file: str) -> Any:
    return network_factory.load_network(load_weights(Path(file))).first_stage_model
