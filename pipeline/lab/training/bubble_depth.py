"""Task: what presses on a bubble's membrane, and where, from two noisy depth frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.core.arrays import Floats
from pipeline.core.params import setting
from pipeline.lab.training import bubble_presses
from pipeline.lab.training.bubble_presses import BubblePress
from pipeline.lab.training.task import VALIDATION_SEED, SimulatedPresses
from pipeline.physics import bubble
from pipeline.physics.simulation.poses import DEPTH_RANGE_MM
from pipeline.stages.depth.bubble_depth import compute_displacement
from pipeline.stages.depth.bubble_network_input import make_network_input
from pipeline.stages.depth.bubble_network_output import BubbleOutputTensors, decode_tensors

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.lab.training.task import Example, Split

# the object's surface is trained where it is at most this far behind the membrane
OBSERVED_GAP_MM = 0.5
_UNTOUCHED_SHARE = 0.1
_TIP_MM = 1.5  # decay of the weight behind the object's tip: a stiffer sensor feels the tip alone
_SMALL_CONTACT_PX = 50.0  # contacts of fewer pixels weigh less


@dataclass(frozen=True, slots=True, kw_only=True)
class BubbleDepthTask(SimulatedPresses):
    """Settings of the examples and weights of the loss."""

    side: int = setting(
        140,
        "Crop side",
        unit="px",
        low=32,
        high=1024,
        step=2,
        help="of the square cut from a frame",
    )
    membrane_weight: float = setting(0.5, "Membrane weight", low=0.0, high=100.0)
    mask_weight: float = setting(0.15, "Mask weight", low=0.0, high=100.0)
    uncertainty_weight: float = setting(0.05, "Uncertainty weight", low=0.0, high=100.0)
    touch_weight: float = setting(
        0.0,
        "Touch weight",
        low=0.0,
        high=100.0,
        help="of what a gel would feel of the object's tip",
    )

    def sample(self, rng: np.random.Generator) -> Example:
        """A press with new noise: a crop of the frame, rotated by quarter turns or mirrored."""
        index = int(rng.integers(self.n_presses))
        press = bubble_presses.simulate_bubble_press(
            "training", self.press_seed, index, self.folder
        )
        if rng.random() < _UNTOUCHED_SHARE:
            zero = np.zeros_like(press.indentation_mm)
            press = replace(
                press,
                indentation_mm=zero,
                contact=np.zeros_like(press.contact),
                gap_mm=np.full_like(zero, bubble_presses.MAX_GAP_MM),
                incidence_cosine=bubble.compute_rest_cosine(press.sensor).astype(np.float32),
            )
        example = _make_example(press, rng, plain=False)
        rows, cols = press.indentation_mm.shape
        top, left = (int(rng.integers(0, max(n - self.side, 0) + 1)) for n in (rows, cols))
        quarters = int(rng.integers(4))
        mirror = bool(rng.integers(2))

        def crop_and_flip(a: Floats) -> Floats:
            part = np.rot90(
                a[..., top : top + self.side, left : left + self.side], quarters, axes=(-2, -1)
            )
            return np.ascontiguousarray(part[..., ::-1] if mirror else part)

        return {name: crop_and_flip(a) for name, a in example.items()}

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A whole frame of a training object in a new pose, or of an unseen tool."""
        press = bubble_presses.simulate_bubble_press(split, VALIDATION_SEED, index, self.folder)
        return _make_example(press, np.random.default_rng([2, index]), plain=True)

    def compute_loss(
        self, network: nn.Module, batch: Mapping[str, Tensor]
    ) -> tuple[Tensor, dict[str, Any]]:
        """Errors of the object's surface, the membrane and both masks, and likelihood of the
        predicted uncertainty.
        """
        import torch
        from torch.nn import functional

        prediction = decode_tensors(network(batch["image"]), batch["smooth"])
        truth = batch["truth"]
        displacement = truth[:, 0]
        gap = truth[:, 1]
        contact = truth[:, 2]
        observed = (gap < OBSERVED_GAP_MM).float()
        weight = observed * (
            1.0 + 3.0 * torch.exp(-torch.clamp(batch["tip_mm"][:, 0], min=0.0) / _TIP_MM)
        )
        error = torch.abs(prediction.object_displacement_mm - (displacement - gap))
        surface = ((error * weight).sum((1, 2)) / (weight.sum((1, 2)) + _SMALL_CONTACT_PX)).mean()
        membrane_error = torch.abs(prediction.displacement_mm - displacement)
        membrane = membrane_error.mean()
        masks = functional.binary_cross_entropy_with_logits(prediction.contact, contact)
        masks = masks + functional.binary_cross_entropy_with_logits(
            prediction.object_in_view, observed
        )
        known = torch.where(observed > 0, error, membrane_error).detach()
        spread = (known * torch.exp(-prediction.log_error) + prediction.log_error).mean()
        touch = _compute_touch_error(prediction, displacement - gap, batch["tip_mm"][:, 0])
        loss = (
            surface
            + self.membrane_weight * membrane
            + self.mask_weight * masks
            + self.uncertainty_weight * spread
        )
        loss = loss + self.touch_weight * touch
        terms = {
            "surface": surface,
            "membrane": membrane,
            "masks": masks,
            "spread": spread,
            "touch": touch,
        }
        return loss, {name: term.detach() for name, term in terms.items()}

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Errors of the object's surface where it is observed and of the membrane, and IoU of
        both masks.
        """
        import torch

        rows: list[tuple[float, ...]] = []
        for example in held_out:
            with torch.inference_mode():
                image, smooth = (torch.tensor(example[k])[None] for k in ("image", "smooth"))
                prediction = decode_tensors(network(image), smooth)
            displacement, gap, contact = example["truth"]
            observed = gap < OBSERVED_GAP_MM
            predicted = prediction.contact[0].numpy() > 0
            error = np.abs(prediction.object_displacement_mm[0].numpy() - (displacement - gap))
            tip = observed & (example["tip_mm"][0] < 1.0)
            predicted_observed = prediction.object_in_view[0].numpy() > 0
            rows.append(
                (
                    float(error[observed].mean()),
                    float(error[tip].mean()),
                    float(np.abs(prediction.displacement_mm[0].numpy() - displacement).mean()),
                    _compute_iou(predicted, contact > 0),
                    _compute_iou(observed, predicted_observed),
                )
            )
        names = (
            "object surface error, mm",
            "object tip error, mm",
            "membrane error, mm",
            "contact IoU",
            "observed object IoU",
        )
        return dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True))


def _compute_touch_error(
    prediction: BubbleOutputTensors, object_mm: Tensor, behind_tip_mm: Tensor
) -> Tensor:
    """Expected error of the object's depth in a gel at a random level, where contact is stated
    with its probability.
    """
    import torch

    low, high = DEPTH_RANGE_MM
    level = (
        low
        + (high - low) * torch.rand(len(object_mm), 1, 1, device=object_mm.device)
        - behind_tip_mm
    )
    true = torch.clamp(level, min=0.0)
    stated = torch.clamp(level + prediction.object_displacement_mm - object_mm, min=0.0)
    share = torch.sigmoid(prediction.contact)
    error = (share * torch.abs(stated - true) + (1.0 - share) * true).sum((1, 2))
    return (error / ((true > 0).sum((1, 2)) + _SMALL_CONTACT_PX)).mean()


def _compute_iou(a: Any, b: Any) -> float:
    return np.count_nonzero(a & b) / max(np.count_nonzero(a | b), 1)


def _make_example(press: BubblePress, rng: np.random.Generator, *, plain: bool) -> Example:
    rest, now = bubble_presses.simulate_noisy_depth_pair(press, rng, plain=plain)
    displacement, level, valid, _ = compute_displacement(
        rest, now, press.sensor.limits.indentation_max_mm, []
    )
    network_input = make_network_input(displacement, level, valid, press.sensor.pixel_mm)
    surface = press.sensor.rest_depth_mm.astype(np.float32) - press.indentation_mm + press.gap_mm
    observed = press.gap_mm < OBSERVED_GAP_MM
    behind_tip = surface - (surface[observed].min() if observed.any() else 0.0)
    return {
        "image": network_input.channels,
        "smooth": network_input.smooth_displacement_mm[None],
        "truth": np.stack([press.indentation_mm, press.gap_mm, press.contact.astype(np.float32)]),
        "tip_mm": behind_tip.astype(np.float32)[None],
    }
