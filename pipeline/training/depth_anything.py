"""Depth Anything V2 for a sensor, as the paper teaches it: SiLog of the depth and cross entropy of the contact."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask
from pipeline.base.params import setting
from pipeline.networks.picturing import as_shown, sized
from pipeline.sensors.spec import sensor
from pipeline.simulation import poses, shapes, variation
from pipeline.simulation.press import photograph, press
from pipeline.training.own import Known
from pipeline.training.silog import silog

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.task import Example, Split

_OFFSET_MM = 0.1  # the logarithm is of indentation and this: a touch of nothing counts, but not without end
_SILOG_SHARE = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthAnythingTask:
    """What its examples are made of, and what of an answer counts for how much."""

    sensor: str = setting("gelslim", "Sensor")
    side: int = setting(140, "Shorter side", unit="px", low=28, high=1400, step=14)
    shows: Literal["picture", "difference"] = setting("picture", "Shows", choices=("picture", "difference"))
    largest_mm: float = setting(
        2.0, "Largest indentation", unit="mm", low=0.01, high=100.0, help="what the answer 1 is"
    )
    vary: float = setting(1.0, "How far units differ", low=0.0, high=variation.MAX_STRENGTH)
    silog: float = setting(1.0, "Weight of SiLog", low=0.0, high=100.0)
    contact: float = setting(1.0, "Weight of the contact", low=0.0, high=100.0)
    metric: float = setting(0.0, "Weight of the error in mm", low=0.0, high=100.0, help="0 = as the paper has it")

    def sample(self, rng: np.random.Generator) -> Example:
        """A press of a training object by another unit, at any of the paper's poses."""
        return self._example(rng, shapes.names("training"))

    def of_touch(self, known: Known, rng: np.random.Generator) -> Example:  # noqa: ARG002 - nothing is left to chance
        """A touch of the user's."""
        reference = known.frame.reference
        assert reference is not None
        return self._shown(known.frame.image, reference, known.indentation_mm, known.contact)

    def held_out(self, split: Split, index: int) -> Example:
        """A press of another grasp, or of an object that is never learned from."""
        group = "training" if split == "unseen_grasps" else "unseen"
        return self._example(np.random.default_rng([17, len(split), index]), shapes.names(group))

    def _example(self, rng: np.random.Generator, names: Sequence[str]) -> Example:
        thing = shapes.shape(names[int(rng.integers(len(names)))]).mesh
        seeds = [int(seed) for seed in rng.integers(2**31, size=4)]
        unit = variation.varied(sensor(self.sensor), seeds[0], self.vary)
        felt = press(thing, poses.paper_grid(thing, n=1, seed=seeds[1])[0], unit, seed=seeds[2])
        still = np.zeros(unit.camera.shape, np.float32)
        rest = photograph(unit, still, unit.rest_depth_mm, seeds[3])
        truth = felt.truth
        assert truth.indentation_mm is not None
        assert truth.contact is not None
        return self._shown(felt.image, rest, truth.indentation_mm, truth.contact)

    def _shown(self, image: Image | Floats, rest: Image | Floats, indentation_mm: Floats, contact: Mask) -> Example:
        shown = as_shown(image, rest, self.shows)
        parts: list[Floats] = [sized(p, self.side) for p in (shown, indentation_mm, contact.astype(np.float32))]
        return {
            "picture": np.ascontiguousarray(parts[0].transpose(2, 0, 1)),
            "indentation_mm": parts[1], "contact": (parts[2] > 0.5).astype(np.float32),
        }  # fmt: skip

    def loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """SiLog where it touches, cross entropy of the contact everywhere, the error in mm where asked for."""
        from torch.nn import functional

        depth, contact = network(batch["picture"])
        found, truth, touched = self.largest_mm * depth, batch["indentation_mm"], batch["contact"]
        parts: dict[str, Any] = {
            "silog": silog(found + _OFFSET_MM, truth + _OFFSET_MM, touched, share=_SILOG_SHARE, least=_OFFSET_MM / 2),
            "contact": functional.binary_cross_entropy_with_logits(contact, touched),
            "metric": (found - truth).abs().mean(),
        }
        total = self.silog * parts["silog"] + self.contact * parts["contact"] + self.metric * parts["metric"]
        return total, {name: part.detach() for name, part in parts.items()}

    def figures(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Overlap of the contact and the error of the indentation where it truly touches."""
        import torch

        device, errors, both, either = next(network.parameters()).device, 0.0, 0.0, 0.0
        for one in held_out:
            depth, contact = network(torch.from_numpy(one["picture"])[None].to(device))
            told, touched = (contact[0] > 0).cpu().numpy(), one["contact"] > 0.5
            apart = np.abs(self.largest_mm * depth[0].cpu().numpy() - one["indentation_mm"])
            errors += float((apart * touched).sum())
            both, either = both + float((told & touched).sum()), either + float((told | touched).sum())
        touched_px = sum(float((one["contact"] > 0.5).sum()) for one in held_out)
        return {
            "overlap of the contact, 1": both / max(either, 1.0),
            "error in contact, um": 1e3 * errors / max(touched_px, 1.0),
        }
