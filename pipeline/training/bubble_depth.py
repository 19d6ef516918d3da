"""To read a bubble: what presses on its membrane and where, from two noisy depth images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.params import setting
from pipeline.physics import bubble_camera
from pipeline.stages.depth.bubble_depth import compute_displacement
from pipeline.stages.depth.bubble_network_input import make_network_input
from pipeline.stages.depth.bubble_network_output import decode_tensors
from pipeline.training import bubble_noise, bubble_presses
from pipeline.training.bubble_presses import BubblePress, DataSplit

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.task import Example, Split

OBSERVED_GAP_MM = 0.5  # the object is told where it is this close behind the membrane, or touches it
_UNTOUCHED = 0.1  # share of the examples
_TIP_MM = 1.5  # what comes first counts for most: all that a stiffer sensor feels
_BUILD_UP = 50.0  # pixels: a touch of fewer counts for less


@dataclass(frozen=True, slots=True, kw_only=True)
class BubbleDepthTask:
    """How examples are made, and what of an answer counts for how much."""

    n_presses: int = setting(4000, "Presses", low=1, high=10_000_000, help="that all examples are drawn from")
    press_seed: int = setting(1, "Seed of the presses", low=0, high=2**31 - 1)
    folder: str = setting("", "Folder", help="keeps the presses for other runs; empty = worked out each time")
    side: int = setting(140, "Side", unit="px", low=32, high=1024, step=2, help="of the square cut out of a reading")
    membrane_weight: float = setting(0.5, "Weight of the membrane", low=0.0, high=100.0)
    mask_weight: float = setting(0.15, "Weight of the masks", low=0.0, high=100.0)
    uncertainty_weight: float = setting(0.05, "Weight of the spread", low=0.0, high=100.0)

    def sample(self, rng: np.random.Generator) -> Example:
        """A press with fresh noise, a part of the picture, turned or mirrored."""
        index = int(rng.integers(self.n_presses))
        found = bubble_presses.simulate_bubble_press("learned", self.press_seed, index, self.folder)
        if rng.random() < _UNTOUCHED:
            nothing = np.zeros_like(found.indentation_mm)
            found = replace(
                found, indentation_mm=nothing, contact=np.zeros_like(found.contact),
                gap_mm=np.full_like(nothing, bubble_presses.MAX_GAP_MM),
                incidence_cosine=bubble_camera.compute_rest_cosine(found.sensor).astype(np.float32),
            )  # fmt: skip
        whole = _example(found, rng, plain=False)
        rows, cols = found.indentation_mm.shape
        top, left = (int(rng.integers(0, max(n - self.side, 0) + 1)) for n in (rows, cols))
        turn, mirror = int(rng.integers(4)), bool(rng.integers(2))

        def crop_and_flip(a: Floats) -> Floats:
            part = np.rot90(a[..., top : top + self.side, left : left + self.side], turn, axes=(-2, -1))
            return np.ascontiguousarray(part[..., ::-1] if mirror else part)

        return {name: crop_and_flip(a) for name, a in whole.items()}

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A whole reading of a training object as it was never held, or of one that is never learned from."""
        rng = np.random.default_rng([2, index])
        return _example(simulate_validation_press(split, index, self.folder), rng, plain=True)

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """Errors of the object's surface, of the membrane, of both masks, and how well the spread fits the first."""
        import torch
        from torch.nn import functional

        found, truth = decode_tensors(network(batch["picture"]), batch["smooth"]), batch["truth"]
        moved, gap, touched = truth[:, 0], truth[:, 1], truth[:, 2]
        told = (gap < OBSERVED_GAP_MM).float()
        weight = told * (1.0 + 3.0 * torch.exp(-torch.clamp(batch["tip_mm"][:, 0], min=0.0) / _TIP_MM))
        off = torch.abs(found.object_displacement_mm - (moved - gap))
        surface = ((off * weight).sum((1, 2)) / (weight.sum((1, 2)) + _BUILD_UP)).mean()
        membrane = torch.abs(found.displacement_mm - moved).mean()
        masks = functional.binary_cross_entropy_with_logits(found.contact, touched)
        masks = masks + functional.binary_cross_entropy_with_logits(found.object_in_view, told)
        error = torch.where(told > 0, off, torch.abs(found.displacement_mm - moved)).detach()
        spread = (error * torch.exp(-found.log_error) + found.log_error).mean()
        loss = surface + self.membrane_weight * membrane + self.mask_weight * masks + self.uncertainty_weight * spread
        parts = {"surface": surface, "membrane": membrane, "masks": masks, "spread": spread}
        return loss, {name: part.detach() for name, part in parts.items()}

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Error of the object's surface where it is told, of the membrane, and overlap of the contact."""
        import torch

        rows: list[tuple[float, ...]] = []
        for example in held_out:
            with torch.inference_mode():
                picture, smooth = (torch.tensor(example[k])[None] for k in ("picture", "smooth"))
                found = decode_tensors(network(picture), smooth)
            moved, gap, touched = example["truth"]
            told, contact = gap < OBSERVED_GAP_MM, found.contact[0].numpy() > 0
            off = np.abs(found.object_displacement_mm[0].numpy() - (moved - gap))
            tip = told & (example["tip_mm"][0] < 1.0)
            both = np.count_nonzero(contact | (touched > 0))
            told_found = found.object_in_view[0].numpy() > 0
            rows.append((
                float(off[told].mean()), float(off[tip].mean()),
                float(np.abs(found.displacement_mm[0].numpy() - moved).mean()),
                np.count_nonzero(contact & (touched > 0)) / max(both, 1),
                np.count_nonzero(told & told_found) / max(np.count_nonzero(told | told_found), 1),
            ))  # fmt: skip
        names = ("object's surface off, mm", "its foremost mm off, mm", "membrane off, mm", "contact, IoU", "told, IoU")
        return dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True))


def simulate_validation_press(split: Split, index: int, folder: str = "") -> BubblePress:
    """Press `index` of what is never learned from."""
    things: DataSplit = split
    return bubble_presses.simulate_bubble_press(things, 7, index, folder)


def _example(found: BubblePress, rng: np.random.Generator, *, plain: bool) -> Example:
    rest, now = bubble_noise.simulate_noisy_depth_pair(found, rng, plain=plain)
    moved, level, seen, _ = compute_displacement(rest, now, found.sensor.limits.indentation_max_mm, [])
    looked_at = make_network_input(moved, level, seen, found.sensor.pixel_mm)
    height = found.sensor.rest_depth_mm.astype(np.float32) - found.indentation_mm + found.gap_mm
    told = found.gap_mm < OBSERVED_GAP_MM
    behind = height - (height[told].min() if told.any() else 0.0)
    return {
        "picture": looked_at.channels,
        "smooth": looked_at.smooth_displacement_mm[None],
        "truth": np.stack([found.indentation_mm, found.gap_mm, found.contact.astype(np.float32)]),
        "tip_mm": np.where(told, behind, np.float32(1e3)).astype(np.float32)[None],
    }
