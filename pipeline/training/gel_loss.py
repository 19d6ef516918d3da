"""Loss of the network that corrects the physical depth of gels (`networks.gel_depth`)."""

# ruff: noqa: TID253 (imported where a loss is computed)
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from pipeline.networks.gel_depth import GelDepthPrediction

# Weights of the surface error in and outside contact, and of the other terms: chosen by hand.
_CONTACT_WEIGHT, _OUTSIDE_WEIGHT = 3.0, 0.7
_SLOPE_TERM, _CONTACT_TERM, _OVERLAP_TERM, _UNCERTAINTY_TERM = 5.0, 0.7, 0.5, 0.05
_DEPTH_MIN = 0.1  # depths of the physical contact: errors of shallower touches are not weighted up further


def compute_loss(prediction: GelDepthPrediction, indentation: Tensor, contact: Tensor) -> tuple[Tensor, dict[str, Any]]:
    """The loss of a batch and its five terms, detached.

    indentation (n, rows, cols) in depths of the physical contact; contact (n, rows, cols), 0 or 1, with at least one
    pixel in contact per example. Surfaces are compared at the scale that the network predicts.
    """
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
