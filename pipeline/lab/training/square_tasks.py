"""Tasks whose network makes a square image of the target: the paper's latent diffusion, for touch
to touch and touch to depth to touch, and its baseline, a VQ-VAE.

The target is as described and without noise; the source is any sensor instance, with noise.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.core.arrays import Floats
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.params import setting
from pipeline.lab.training.distributed import unwrap_network
from pipeline.lab.training.recorded_pairs import RecordedPair
from pipeline.lab.training.simulated_touches import (
    BUBBLE,
    GEL,
    DataSplit,
    find_next_contact,
    flip_arrays,
    load_working_sensor,
    mirror_pair,
    place_nominal_sensors,
    sample_depth_noise,
    simulate_target_touch,
    simulate_touch_pair,
)
from pipeline.lab.training.task import (
    VALIDATION_SEED,
    AugmentedPresses,
    TargetSensor,
    average_rows,
    weigh_terms,
)
from pipeline.physics.sensor_images import render_reference, render_sensor_image
from pipeline.sensors.alignment import Alignment, resolve_alignment
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.networks.network_factory import load_network
from pipeline.stages.networks.touch_formats import (
    SIDE,
    decode_image,
    denormalise,
    encode_image,
    normalise,
    resize_to_square,
)
from pipeline.stages.networks.weights_registry import load_file
from pipeline.stages.touch.image_condition import reproject_square
from pipeline.stages.touch.latent_diffusion import build_image_square
from pipeline.stages.touch.t2d2 import build_depth_square

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.lab.training.task import Example, Split

Condition = Literal["image", "reprojected", "depth"]
TrainedPart = Literal["both", "autoencoder", "denoiser"]
_LATENT_CHANNELS = 4
_LATENT_DOWNSAMPLING = 8
_N_TIMES = 1000
# weights in the loss
_KL_TERM = 1e-4
_COMMITMENT_TERM = 0.25
_TOUCHED_SHARE = 0.05  # of the largest change: larger changes count as touched


@frozen
class SquarePair:
    """Changes (channels, side, side) of both sensors."""

    source_change: Floats
    target_change: Floats
    source: SensorSpec
    target: SensorSpec
    alignment: Alignment


@frozen
class SquareTask(AugmentedPresses):
    """Examples of a source's square and the target's, simulated or recorded."""

    target: TargetSensor = setting(BUBBLE, "Target", choices=TargetSensor)
    side: int = setting(
        SIDE, "Image side", unit="px", low=32, high=512, step=32, help="256 in the paper"
    )

    @property
    def pair_sensors(self) -> tuple[str, str]:
        """Names of source and target."""
        return (GEL, BUBBLE) if self.target == BUBBLE else (BUBBLE, GEL)

    @abstractmethod
    def make_example(self, pair: SquarePair) -> Example:
        """The arrays `source` and `target` of a pair."""

    def simulate_example(
        self, split: DataSplit, seed: int, index: int, rng: np.random.Generator, augmented: float
    ) -> Example:
        """Touch `index`, or the next one with contact; mirrored with probability `augmented`."""
        onto_bubble = self.target == BUBBLE
        pair = find_next_contact(
            lambda k: simulate_touch_pair(
                split, seed, k, self.folder, bubble_alone=not onto_bubble
            ),
            index,
        )
        if rng.random() < augmented:
            pair = mirror_pair(pair, rng)
        source, target = place_nominal_sensors(pair.placement)
        target_mm = pair.bubble_mm
        if onto_bubble:
            noise = rng.standard_normal(pair.change_grey.shape, np.float32)
            change = (pair.change_grey + noise) / np.float32(255.0)
        else:
            source, target = target, source
            change = (target_mm + sample_depth_noise(rng, target_mm.shape))[..., None]
            target_mm = pair.gel_mm
        return self.make_example(
            SquarePair(
                source_change=resize_to_square(change, self.side),
                target_change=render_square(target, target_mm, self.side),
                source=source,
                target=target,
                alignment=resolve_alignment(source, target),
            )
        )

    def sample(self, rng: np.random.Generator) -> Example:
        """A touch of a training object or of a random body."""
        index = int(rng.integers(self.n_presses))
        example = self.simulate_example(
            "training", self.press_seed, index, rng, self.augmentation_share
        )
        return self.make_pair_example(example, rng, is_validation=False)

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A training object in a new pose, or an unseen tool."""
        rng = np.random.default_rng([5, index])
        example = self.simulate_example(split, VALIDATION_SEED, index, rng, 0.0)
        return self.make_pair_example(example, rng, is_validation=True)

    def prepare_pair(self, pair: RecordedPair) -> Example:
        """The example of a recorded touch; a missing reference is the described one."""

        def read(frame: Any, sensor: SensorSpec) -> Floats:
            reference = render_reference(sensor) if frame.reference is None else frame.reference
            change = sensor.sensor_kind.compute_relative_change(frame.image, reference)
            return resize_to_square(change, self.side)

        return self.make_example(
            SquarePair(
                source_change=read(pair.source_frame, pair.source),
                target_change=read(pair.target_frame, pair.target),
                source=pair.source,
                target=pair.target,
                alignment=pair.alignment,
            )
        )


def render_square(sensor: SensorSpec, indentation_mm: Floats, side: int) -> Floats:
    """Change (channels, side, side) of a sensor as described, without noise."""
    image = render_sensor_image(sensor, indentation_mm, sensor.rest_depth_mm - indentation_mm, None)
    change = sensor.sensor_kind.compute_relative_change(image, render_reference(sensor))
    return resize_to_square(change, side)


@frozen
class LatentTask(SquareTask):
    """Latent diffusion. Autoencoder, condition encoder and denoiser are trained at once or one
    after the other; the denoiser's gradient does not reach the latents.
    """

    condition: Condition = setting(
        "image",
        "Condition",
        choices=Condition,
        help="must equal `condition` of the network; image in the paper's T2T",
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

    def simulate_example(
        self, split: DataSplit, seed: int, index: int, rng: np.random.Generator, augmented: float
    ) -> Example:
        """A pair's condition and image, or those of the target alone where its depth is the
        condition.
        """
        if self.condition != "depth":
            return SquareTask.simulate_example(self, split, seed, index, rng, augmented)
        touch = find_next_contact(
            lambda k: simulate_target_touch(self.target, split, seed, k, self.folder), index
        )
        names = ("observed_mm", "observed", "in_view", "target_mm")
        fields = {name: getattr(touch, name) for name in names}
        if rng.random() < augmented:
            fields = flip_arrays(fields, ((0,), (1,), (0, 1))[int(rng.integers(3))])
        sensor = load_working_sensor(self.target)
        change = render_square(sensor, fields.pop("target_mm"), self.side)
        observed_mm, observed, in_view = fields.values()
        condition = build_depth_square(sensor.kind, observed_mm, observed, in_view, self.side)
        return {"source": condition, "target": encode_image(change, sensor.kind)}

    def make_example(self, pair: SquarePair) -> Example:
        """Condition and target image; raises SettingProblem where the target's depth is the
        condition.
        """
        if self.condition == "depth":
            raise SettingProblem(
                "touch to depth to touch trains on the target's touches alone, not on pairs"
            )
        condition = build_image_square(
            pair.source_change, self.condition, pair.source, pair.target, pair.alignment
        )
        return {
            "source": np.array(condition, np.float32),
            "target": encode_image(pair.target_change, pair.target.kind),
        }

    def make_pair_example(
        self, prepared: Example, rng: np.random.Generator, *, is_validation: bool
    ) -> Example:
        """With the target's latents, or, to validate, with a time and noise: every validation is
        of the same ones.
        """
        if not is_validation:
            if not self.autoencoder:
                return prepared
            return {**prepared, "target": _encode(self.autoencoder, prepared["target"])}
        side = self.side // _LATENT_DOWNSAMPLING
        return {
            **prepared,
            "time": np.array([rng.integers(_N_TIMES)], np.float32),
            "noises": rng.standard_normal((2, _LATENT_CHANNELS, side, side), np.float32),
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
        terms: dict[str, tuple[float, Tensor]] = {}
        if output.predicted_noise is not None:
            terms["noise"] = 1.0, (output.predicted_noise - output.true_noise).abs().mean()
        if output.reconstruction is not None:
            error = (output.reconstruction - batch["target"]).abs().mean()
            divergence = output.mean**2 + output.log_variance.exp() - 1.0 - output.log_variance
            terms["reconstruction"] = self.reconstruction_weight, error
            terms["kl"] = _KL_TERM, 0.5 * divergence.mean()
        return weigh_terms(terms)

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Mean absolute errors of the autoencoder's reconstruction and of the predicted noise."""
        import torch

        kind = load_sensor(self.target).sensor_kind
        rows: list[dict[str, float]] = []
        for example in held_out:
            batch = {name: torch.tensor(array)[None] for name, array in example.items()}
            time = batch["time"][:, 0].long()
            noises = batch["noises"].transpose(0, 1)
            with torch.inference_mode():
                output = network(batch["target"], batch["source"], time, torch.ones(1), noises)
            images = (
                decode_image(a, kind.key)
                for a in (output.reconstruction[0].numpy(), example["target"])
            )
            reconstruction = kind.full_change * float(np.abs(np.subtract(*images)).mean())
            noise = float((output.predicted_noise - output.true_noise).abs().mean())
            name = f"reconstruction error, {kind.change_unit}"
            rows.append({name: reconstruction, "noise error": noise})
        return average_rows(rows)


def _encode(file: str, target: Floats) -> Floats:
    """(8, side / 8, side / 8): mean and log variance of the latents of an image (3, side, side)
    in -1..1.
    """
    import torch

    network: Any = load_network(load_file(Path(file)))
    with torch.inference_mode():
        moments = network.first_stage_model.encode(torch.tensor(target)[None])
    return torch.cat(moments, dim=1)[0].numpy()


@frozen
class VqVaeTask(SquareTask):
    """One sensor's change from another's by a VQ-VAE."""

    reprojects_input: bool = setting(
        False,
        "Reprojected sources",
        help="must equal `reprojects_input` of the network; off in the paper",
    )

    def make_example(self, pair: SquarePair) -> Example:
        """Both changes, normalised; the source's drawn where the target looks if so chosen."""
        if self.reprojects_input:
            shown = reproject_square(pair.source_change, pair.source, pair.target, pair.alignment)
        else:
            shown = normalise(pair.source_change, pair.source.kind)
        return {"source": shown, "target": normalise(pair.target_change, pair.target.kind)}

    def compute_loss(
        self, network: nn.Module, batch: Mapping[str, Tensor]
    ) -> tuple[Tensor, dict[str, Any]]:
        """Mean squared errors of the output, of the codes from the encoder and of the encoder
        from its codes.
        """
        from torch.nn.functional import mse_loss

        if unwrap_network(network).reprojects_input != self.reprojects_input:
            raise SettingProblem("reprojects_input must be the same in [network] and in [settings]")
        output = network(batch["source"])
        codebook = mse_loss(output.quantised, output.encoded.detach())
        commitment = mse_loss(output.encoded, output.quantised.detach())
        return weigh_terms(
            {
                "reconstruction": (1.0, mse_loss(output.generated, batch["target"])),
                "codebook": (1.0, codebook),
                "commitment": (_COMMITMENT_TERM, commitment),
            }
        )

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Mean absolute error over all, and where the touch changes the target."""
        import torch

        kind = load_sensor(self.target).sensor_kind
        rows: list[dict[str, float]] = []
        for example in held_out:
            with torch.inference_mode():
                generated = network(torch.tensor(example["source"])[None]).generated[0].numpy()
            truth = denormalise(example["target"], kind.key)
            error = kind.full_change * np.abs(denormalise(generated, kind.key) - truth)
            size = np.abs(truth)
            touched = error[size > _TOUCHED_SHARE * size.max()].mean()
            unit = kind.change_unit
            rows.append({f"error, {unit}": error.mean(), f"error where touched, {unit}": touched})
        return average_rows(rows)
