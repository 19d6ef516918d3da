"""Depth Anything V2 for a sensor, as the paper teaches it: SiLog of the depth and cross entropy of the contact."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask
from pipeline.base.params import setting
from pipeline.networks.depth_anything_input import prepare_image, resize_to_patches
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import poses, shapes, variation
from pipeline.simulation.press import render_sensor_image, simulate_press
from pipeline.training.recorded_touches import LabelledTouch
from pipeline.training.silog_loss import compute_silog_loss

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
    image_content: Literal["picture", "difference"] = setting("picture", "Shows", choices=("picture", "difference"))
    largest_mm: float = setting(
        2.0, "Largest indentation", unit="mm", low=0.01, high=100.0, help="what the answer 1 is"
    )
    vary: float = setting(1.0, "How far units differ", low=0.0, high=variation.MAX_STRENGTH)
    silog_weight: float = setting(1.0, "Weight of SiLog", low=0.0, high=100.0)
    contact_weight: float = setting(1.0, "Weight of the contact", low=0.0, high=100.0)
    metric_weight: float = setting(
        0.0, "Weight of the error in mm", low=0.0, high=100.0, help="0 = as the paper has it"
    )

    def sample(self, rng: np.random.Generator) -> Example:
        """A press of a training object by another unit, at any of the paper's poses."""
        return self._example(rng, shapes.list_shapes("training"))

    def make_touch_example(self, known: LabelledTouch, rng: np.random.Generator) -> Example:  # noqa: ARG002 - nothing is left to chance
        """A touch of the user's."""
        reference = known.frame.reference
        assert reference is not None
        return self._shown(known.frame.image, reference, known.indentation_mm, known.contact)

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A press of another grasp, or of an object that is never learned from."""
        group = "training" if split == "unseen_grasps" else "unseen"
        return self._example(np.random.default_rng([17, len(split), index]), shapes.list_shapes(group))

    def _example(self, rng: np.random.Generator, names: Sequence[str]) -> Example:
        thing = shapes.make_shape(names[int(rng.integers(len(names)))]).mesh
        seeds = [int(seed) for seed in rng.integers(2**31, size=4)]
        unit = variation.vary_sensor(load_sensor(self.sensor), seeds[0], self.vary)
        felt = simulate_press(thing, poses.make_paper_grid(thing, n=1, seed=seeds[1])[0], unit, seed=seeds[2])
        still = np.zeros(unit.camera.shape, np.float32)
        rest = render_sensor_image(unit, still, unit.rest_depth_mm, seeds[3])
        truth = felt.truth
        assert truth.indentation_mm is not None
        assert truth.contact is not None
        return self._shown(felt.image, rest, truth.indentation_mm, truth.contact)

    def _shown(self, image: Image | Floats, rest: Image | Floats, indentation_mm: Floats, contact: Mask) -> Example:
        shown = prepare_image(image, rest, self.image_content)
        parts: list[Floats] = [
            resize_to_patches(p, self.side) for p in (shown, indentation_mm, contact.astype(np.float32))
        ]
        return {
            "picture": np.ascontiguousarray(parts[0].transpose(2, 0, 1)),
            "indentation_mm": parts[1], "contact": (parts[2] > 0.5).astype(np.float32),
        }  # fmt: skip

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """SiLog where it touches, cross entropy of the contact everywhere, the error in mm where asked for."""
        from torch.nn import functional

        depth, contact = network(batch["picture"])
        found, truth, touched = self.largest_mm * depth, batch["indentation_mm"], batch["contact"]
        parts: dict[str, Any] = {
            "silog": compute_silog_loss(
                found + _OFFSET_MM, truth + _OFFSET_MM, touched, share=_SILOG_SHARE, least=_OFFSET_MM / 2
            ),
            "contact": functional.binary_cross_entropy_with_logits(contact, touched),
            "metric": (found - truth).abs().mean(),
        }
        total = (
            self.silog_weight * parts["silog"]
            + self.contact_weight * parts["contact"]
            + self.metric_weight * parts["metric"]
        )
        return total, {name: part.detach() for name, part in parts.items()}

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
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
