"""Task: one sensor's change from another's by a VQ-VAE, the paper's baseline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.core.arrays import Floats
from pipeline.core.errors import SettingProblem
from pipeline.core.params import setting
from pipeline.lab.training.distributed import unwrap_network
from pipeline.lab.training.recorded_pairs import RecordedPair
from pipeline.lab.training.task import VALIDATION_SEED, SimulatedPresses
from pipeline.lab.training.touch_pairs import BUBBLE, GEL
from pipeline.lab.training.touch_squares import (
    Direction,
    SquarePair,
    list_pair_sensors,
    load_nominal_sensors,
    read_square_pair,
    simulate_touch_squares,
)
from pipeline.sensors import alignment
from pipeline.sensors.spec import load_sensor
from pipeline.stages.networks.touch_formats import denormalise, normalise
from pipeline.stages.touch.image_condition import reproject_square

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.lab.training.task import Example, Split

_TOUCHED_SHARE = 0.05  # of the largest change: larger changes count as touched


@dataclass(frozen=True, slots=True, kw_only=True)
class VqVaeTask(SimulatedPresses):
    """Settings of the examples and weights of the loss."""

    direction: Direction = setting("gel_to_bubble", "Direction", choices=Direction)
    mirror_share: float = setting(
        0.0,
        "Mirrored share",
        low=0.0,
        high=1.0,
        help="as in the paper; a mirrored gel has mirrored LEDs",
    )
    reprojects_input: bool = setting(
        False,
        "Reprojected sources",
        help="must equal `reprojects_input` of the network; off in the paper",
    )
    codebook_weight: float = setting(1.0, "Codebook weight", low=0.0, high=100.0)
    commitment_weight: float = setting(0.25, "Commitment weight", low=0.0, high=100.0)

    def sample(self, rng: np.random.Generator) -> Example:
        """A pair of normalised squares, mirrored together."""
        touch = simulate_touch_squares(
            "training", self.press_seed, int(rng.integers(self.n_presses)), self.folder
        )
        return self._mirror(self._make_example(touch.get_pair(self.direction)), rng)

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A training object in a new pose, or an unseen tool."""
        touch = simulate_touch_squares(split, VALIDATION_SEED, index, self.folder)
        return self._make_example(touch.get_pair(self.direction))

    @property
    def pair_sensors(self) -> tuple[str, str]:
        """Names of source and target."""
        return list_pair_sensors(BUBBLE if self.direction == "gel_to_bubble" else GEL)

    def prepare_pair(self, pair: RecordedPair) -> SquarePair:
        """Both changes as squares."""
        return read_square_pair(pair)

    def make_pair_example(
        self, prepared: SquarePair, rng: np.random.Generator, *, is_validation: bool
    ) -> Example:
        """Normalised squares of a recorded pair, mirrored together."""
        example = self._make_example(prepared)
        return example if is_validation else self._mirror(example, rng)

    def _mirror(self, example: Example, rng: np.random.Generator) -> Example:
        for axis in (-1, -2):
            if rng.random() < self.mirror_share / 2:
                example = {
                    name: np.ascontiguousarray(np.flip(a, axis)) for name, a in example.items()
                }
        return example

    def compute_loss(
        self, network: nn.Module, batch: Mapping[str, Tensor]
    ) -> tuple[Tensor, dict[str, Any]]:
        """Mean squared errors of the output, of the codes from the encoder and of the encoder
        from its codes.
        """
        from torch.nn import functional

        if unwrap_network(network).reprojects_input != self.reprojects_input:
            raise SettingProblem("reprojects_input must be the same in [network] and in [settings]")
        output = network(batch["source"])
        reconstruction = functional.mse_loss(output.generated, batch["target"])
        codebook = functional.mse_loss(output.quantised, output.encoded.detach())
        commitment = functional.mse_loss(output.encoded, output.quantised.detach())
        loss = (
            reconstruction + self.codebook_weight * codebook + self.commitment_weight * commitment
        )
        return loss, {"reconstruction": reconstruction.detach(), "codebook": codebook.detach()}

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Mean absolute error over all, and where the touch changes the target."""
        import torch

        kind = load_sensor(self.pair_sensors[1]).sensor_kind
        rows: list[tuple[float, float]] = []
        for example in held_out:
            with torch.inference_mode():
                generated = (
                    network(torch.from_numpy(np.array(example["source"]))[None])
                    .generated[0]
                    .numpy()
                )
            truth = denormalise(example["target"], kind.key)
            error = np.abs(denormalise(generated, kind.key) - truth)
            size = np.abs(truth)
            touched = size > _TOUCHED_SHARE * size.max()
            rows.append((float(error.mean()), float(error[touched].mean())))
        names = (f"error, {kind.change_unit}", f"error where touched, {kind.change_unit}")
        return dict(zip(names, (kind.full_change * np.mean(rows, axis=0)).tolist(), strict=True))

    def _make_example(self, pair: SquarePair) -> Example:
        if self.reprojects_input:
            shown = _reproject(pair.source, self.direction)
        else:
            shown = normalise(pair.source, pair.source_kind)
        return {"source": shown, "target": normalise(pair.target, pair.target_kind)}


def _reproject(change: Floats, direction: Direction) -> Floats:
    """The source's square drawn where the target looks, as the nominal sensors stand to each
    other.
    """
    gel, bubble = load_nominal_sensors()
    source, target = (gel, bubble) if direction == "gel_to_bubble" else (bubble, gel)
    return reproject_square(change, source, target, alignment.resolve_alignment(source, target))
