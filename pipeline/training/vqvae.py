"""To take one sensor's change for another's by a VQ-VAE: the paper's baseline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.errors import SettingProblem
from pipeline.base.params import setting
from pipeline.networks.square_images import denormalise, normalise
from pipeline.sensors import alignment
from pipeline.stages.touch.image_condition import reproject_square
from pipeline.training.distributed import unwrap_network
from pipeline.training.touch_squares import TouchSquares, load_nominal_sensors, simulate_touch_squares

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.task import Example, Split

Direction = Literal["gel_to_bubble", "bubble_to_gel"]
_HELD_OUT_SEED = 7
_TOUCHED = 0.05  # of the largest change: where a touch shows
_UNITS: dict[str, tuple[str, float]] = {"gel": ("grey", 255.0), "bubble": ("mm", 1.0)}


@dataclass(frozen=True, slots=True, kw_only=True)
class VqVaeTask:
    """How examples are made, and what counts for how much."""

    direction: Direction = setting("gel_to_bubble", "Direction", choices=Direction)
    n_presses: int = setting(2000, "Presses", low=1, high=10_000_000, help="that all examples are drawn from")
    press_seed: int = setting(1, "Seed of the presses", low=0, high=2**31 - 1)
    folder: str = setting("", "Folder", help="keeps the presses for other runs; empty = worked out each time")
    mirror_share: float = setting(
        0.0, "Share of mirrored touches", low=0.0, high=1.0, help="as the paper's; a mirrored gel has mirrored lamps"
    )
    reprojects_input: bool = setting(
        False, "Sources drawn where the target looks", help="as the network's own `laid` says; off for the paper's"
    )
    codebook_weight: float = setting(1.0, "Weight of the codebook", low=0.0, high=100.0)
    commitment_weight: float = setting(0.25, "Weight of the encoder's keeping to it", low=0.0, high=100.0)

    def sample(self, rng: np.random.Generator) -> Example:
        """A pair of normalised squares; mirrored together."""
        touch = simulate_touch_squares("learned", self.press_seed, int(rng.integers(self.n_presses)), self.folder)
        one = self._example(touch)
        for axis in (-1, -2):
            if rng.random() < self.mirror_share / 2:
                one = {name: np.ascontiguousarray(np.flip(a, axis)) for name, a in one.items()}
        return one

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A pair of a training object as it was never held, or of a tool that is never learned from."""
        return self._example(simulate_touch_squares(split, _HELD_OUT_SEED, index, self.folder))

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """Mean squares: of what comes out, of codes from the encoder, and of the encoder from its codes."""
        from torch.nn import functional

        if unwrap_network(network).reprojects_input != self.reprojects_input:
            raise SettingProblem("`laid` must say the same in [network] and in [settings]")
        found = network(batch["source"])
        made = functional.mse_loss(found.generated, batch["target"])
        codebook = functional.mse_loss(found.quantised, found.encoded.detach())
        commitment = functional.mse_loss(found.encoded, found.quantised.detach())
        loss = made + self.codebook_weight * codebook + self.commitment_weight * commitment
        return loss, {"made": made.detach(), "codebook": codebook.detach()}

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Mean absolute error over all, and where the touch shows."""
        import torch

        kind = "bubble" if self.direction == "gel_to_bubble" else "gel"
        unit, times = _UNITS[kind]
        rows: list[tuple[float, float]] = []
        for one in held_out:
            with torch.inference_mode():
                made = network(torch.from_numpy(np.array(one["source"]))[None]).generated[0].numpy()
            truth = denormalise(one["target"], kind)
            off, size = np.abs(denormalise(made, kind) - truth), np.abs(truth)
            rows.append((times * float(off.mean()), times * float(off[size > _TOUCHED * size.max()].mean())))
        return dict(
            zip((f"error, {unit}", f"error where touched, {unit}"), np.mean(rows, axis=0).tolist(), strict=True)
        )

    def _example(self, touch: TouchSquares) -> Example:
        """The source as any unit records it, the target as the described unit does; a bubble's without noise."""
        kinds: tuple[str, str] = ("gel", "bubble") if self.direction == "gel_to_bubble" else ("bubble", "gel")
        if kinds[0] == "gel":
            source, target = touch.gel_change, touch.exact_imprint_mm
        else:
            source, target = touch.bubble_imprint_mm, touch.nominal_gel_change
        shown = _laid(source, self.direction) if self.reprojects_input else normalise(source, kinds[0])
        return {"source": shown, "target": normalise(target, kinds[1])}


def _laid(squeezed: Floats, direction: Direction) -> Floats:
    """As the described units stand to each other, whatever the single ones do."""
    gel, bubble = load_nominal_sensors()
    source, target = (gel, bubble) if direction == "gel_to_bubble" else (bubble, gel)
    return reproject_square(squeezed, source, target, alignment.resolve_alignment(source, target))
