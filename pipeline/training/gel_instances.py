"""Task: correct the physical depth of gels, scale included, on sensor instances that differ as a lab's do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.base.params import setting
from pipeline.stages.depth import gel_network_input
from pipeline.training import instance_samples
from pipeline.training.instance_samples import InstanceSample
from pipeline.training.task import VALIDATION_SEED, StoredPresses

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.networks.gel_depth import GelDepthPrediction
    from pipeline.training.task import Example, Split

_UM_PER_MM = 1e3
# Weights of the surface error in and outside contact, and of the other terms: chosen by hand.
_CONTACT_WEIGHT, _OUTSIDE_WEIGHT = 3.0, 0.7
_SLOPE_TERM, _CONTACT_TERM, _OVERLAP_TERM, _UNCERTAINTY_TERM = 5.0, 0.7, 0.5, 0.05
_DEPTH_MIN = 0.1  # depths of the physical contact: errors of shallower touches are not weighted up further


@dataclass(frozen=True, slots=True, kw_only=True)
class GelInstancesTask(StoredPresses):
    """Settings of the examples."""

    n_frames: int = setting(18_000, "Frames", low=1, high=10_000_000, help="that all examples are drawn from")

    def sample(self, rng: np.random.Generator) -> Example:
        """One frame, mirrored or not."""
        index = int(rng.integers(self.n_frames))
        sample = instance_samples.simulate_instance_sample(self.press_seed, index, self.folder)
        return mirror_example(rng, _make_example(sample))

    def make_validation_example(self, split: Split, index: int) -> Example:
        """Frames of other presses; unseen tools as the simulator presses them."""
        if split == "unseen_tools":
            return _make_example(instance_samples.simulate_unseen_tool(index))
        return _make_example(instance_samples.simulate_instance_sample(VALIDATION_SEED, index, self.folder))

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """The loss of a batch and its terms."""
        return compute_loss(network(batch["fields"]), batch["indentation"], batch["contact"])

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Depth error and contact IoU of the network and of physics alone."""
        import torch

        rows: list[tuple[float, ...]] = []
        for example in held_out:
            with torch.inference_mode():
                prediction = network(torch.from_numpy(np.array(example["fields"]))[None])
            truth, contact = example["indentation"], example["contact"] > 0
            if prediction.log_depth_factor is None or not contact.any():
                continue
            surface = prediction.surface[0].numpy() * float(prediction.log_depth_factor[0].exp())
            physical, um = example["fields"][gel_network_input.SURFACE_CHANNEL], _UM_PER_MM * float(example["depth_mm"])
            predicted = prediction.contact_logit[0].numpy() > 0
            by_physics = example["fields"][gel_network_input.CONTACT_CHANNEL] > 0.5
            rows.append((
                um * float(np.abs(surface - truth)[contact].mean()),
                um * float(np.abs(physical - truth)[contact].mean()),
                *(np.count_nonzero(m & contact) / np.count_nonzero(m | contact) for m in (predicted, by_physics)),
            ))  # fmt: skip
        names = ("error in contact, um", "physics error in contact, um", "contact IoU", "physics contact IoU")
        return dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True)) if rows else {}


def _make_example(sample: InstanceSample) -> Example:
    return {
        "fields": sample.fields, "indentation": sample.indentation, "contact": sample.contact.astype(np.uint8),
        "depth_mm": np.asarray(sample.depth_mm, np.float32),
    }  # fmt: skip


def mirror_example(rng: np.random.Generator, example: Example) -> Example:
    """The example mirrored left to right, top to bottom, both or neither; each with probability 1/2.

    Slopes and positions along a mirrored axis change sign.
    """
    for number, (axis, slopes) in enumerate(zip((-1, -2), gel_network_input.SLOPE_CHANNELS, strict=True)):
        if rng.random() < 0.5:
            example = {k: np.ascontiguousarray(np.flip(v, axis)) if v.ndim else v for k, v in example.items()}
            example["fields"][[*slopes, gel_network_input.POSITION_CHANNEL + number]] *= -1.0
    return example


def compute_loss(prediction: GelDepthPrediction, indentation: Tensor, contact: Tensor) -> tuple[Tensor, dict[str, Any]]:
    """The loss of a batch and its five terms, detached.

    indentation (n, rows, cols) in depths of the physical contact; contact (n, rows, cols), 0 or 1, with at least one
    pixel in contact per example. Surfaces are compared at the scale that the network predicts.
    """
    import torch
    from torch.nn import functional

    surface = prediction.surface * prediction.log_depth_factor.exp()[:, None, None]
    target = contact.float()
    depth = (indentation * target).amax(dim=(1, 2), keepdim=True).clamp(min=_DEPTH_MIN)
    weight = (_OUTSIDE_WEIGHT + (_CONTACT_WEIGHT - _OUTSIDE_WEIGHT) * target) / depth
    error = surface - indentation
    slopes = 0.5 * (
        (weight[..., 1:] * error.diff(dim=-1).abs()).mean() + (weight[..., 1:, :] * error.diff(dim=-2).abs()).mean()
    )
    # Negative log-likelihood of a Laplace distribution of the error; trains the scale alone.
    uncertainty = (error.abs().detach() * torch.exp(-prediction.log_error_scale) + prediction.log_error_scale).mean()
    terms = {
        "surface": (weight * error.abs()).mean(), "slopes": slopes,
        "contact": functional.binary_cross_entropy_with_logits(prediction.contact_logit, target),
        "overlap": _compute_overlap_loss(torch.sigmoid(prediction.contact_logit), target), "spread": uncertainty,
    }  # fmt: skip
    total = (
        terms["surface"] + _SLOPE_TERM * slopes + _CONTACT_TERM * terms["contact"]
        + _OVERLAP_TERM * terms["overlap"] + _UNCERTAINTY_TERM * uncertainty
    )  # fmt: skip
    return total, {name: term.detach() for name, term in terms.items()}


def _compute_overlap_loss(probability: Tensor, target: Tensor) -> Tensor:
    """1 - soft intersection over union, averaged over the examples that have a contact."""
    intersection = (probability * target).sum(dim=(1, 2))
    union = probability.sum(dim=(1, 2)) + target.sum(dim=(1, 2)) - intersection
    has_contact = (target.sum(dim=(1, 2)) > 0).float()
    return (has_contact * (1.0 - (intersection + 1.0) / (union + 1.0))).sum() / has_contact.sum().clamp(min=1.0)
