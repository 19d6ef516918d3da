"""What the network that corrects physics is judged by while it learns."""

# ruff: noqa: TID253 (imported where a loss is asked for)
from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from pipeline.networks.gel_depth import GelDepthPrediction

_INSIDE, _BESIDE, _SLOPES, _CONTACT, _OVERLAP, _SPREAD = 3.0, 0.7, 5.0, 0.7, 0.5, 0.05
_LEAST = 1e-6


def compute_scale_free_loss(
    reading: GelDepthPrediction, indentation: Tensor, contact: Tensor
) -> tuple[Tensor, dict[str, Any]]:
    """The loss and its parts; indentation (n, rows, cols) in depths of the physical contact, contact 0 or 1.

    Surfaces are compared when each has been brought to the true scale by the one factor that suits it best: what is
    left is shape. The spread is of what is handed on, at the scale of physics. Pictures without a contact have no say
    in either.
    """
    touched = contact.float()
    there = (touched.sum(dim=(1, 2), keepdim=True) > 0).float()
    own = _factor(reading.surface, indentation, touched)
    depth = (indentation * touched).amax(dim=(1, 2), keepdim=True).clamp(min=0.1)
    weight = there * (_BESIDE + (_INSIDE - _BESIDE) * touched) / depth
    surface = own * reading.surface
    off = (surface - indentation).abs()
    slopes = 0.5 * (
        (weight[..., 1:] * (_across(surface) - _across(indentation)).abs()).mean()
        + (weight[..., 1:, :] * (_down(surface) - _down(indentation)).abs()).mean()
    )
    told = functional.binary_cross_entropy_with_logits(reading.contact_logit, touched)
    overlap = _overlap(torch.sigmoid(reading.contact_logit), touched)
    as_physics = _factor(reading.surface, reading.surface - reading.correction, touched)
    handed_on = (as_physics * reading.surface - indentation).abs().detach()
    spread = (there * (handed_on * torch.exp(-reading.log_error_scale) + reading.log_error_scale)).mean()
    parts = {"surface": (weight * off).mean(), "slopes": slopes, "contact": told, "overlap": overlap, "spread": spread}
    whole = parts["surface"] + _SLOPES * slopes + _CONTACT * told + _OVERLAP * overlap + _SPREAD * spread
    return whole, {name: part.detach() for name, part in parts.items()}


def compute_absolute_loss(
    reading: GelDepthPrediction, indentation: Tensor, contact: Tensor
) -> tuple[Tensor, dict[str, Any]]:
    """The same of a network that tells the scale: surfaces are compared as they are. Each touch has a contact."""
    assert reading.log_depth_factor is not None
    surface = reading.surface * reading.log_depth_factor.exp()[:, None, None]
    touched = contact.float()
    depth = (indentation * touched).amax(dim=(1, 2), keepdim=True).clamp(min=0.1)
    weight = (_BESIDE + (_INSIDE - _BESIDE) * touched) / depth
    off = surface - indentation
    slopes = 0.5 * ((weight[..., 1:] * _across(off).abs()).mean() + (weight[..., 1:, :] * _down(off).abs()).mean())
    told = functional.binary_cross_entropy_with_logits(reading.contact_logit, touched)
    overlap = _overlap(torch.sigmoid(reading.contact_logit), touched)
    spread = (off.abs().detach() * torch.exp(-reading.log_error_scale) + reading.log_error_scale).mean()
    parts = {"surface": (weight * off.abs()).mean(), "slopes": slopes, "contact": told, "overlap": overlap,
             "spread": spread}  # fmt: skip
    whole = parts["surface"] + _SLOPES * slopes + _CONTACT * told + _OVERLAP * overlap + _SPREAD * spread
    return whole, {name: part.detach() for name, part in parts.items()}


def _factor(surface: Tensor, wanted: Tensor, touched: Tensor) -> Tensor:
    """What brings a surface nearest to another by least squares over the contact: (n, 1, 1), a third to three."""
    both = (touched * surface * wanted).sum(dim=(1, 2), keepdim=True)
    return (both / (touched * surface * surface).sum(dim=(1, 2), keepdim=True).clamp(min=_LEAST)).clamp(0.33, 3.0)


def _across(field: Tensor) -> Tensor:
    return field[..., 1:] - field[..., :-1]


def _down(field: Tensor) -> Tensor:
    return field[..., 1:, :] - field[..., :-1, :]


def _overlap(share: Tensor, touched: Tensor) -> Tensor:
    """1 - a soft intersection over union, the mean over those that are touched."""
    both = (share * touched).sum(dim=(1, 2))
    either = share.sum(dim=(1, 2)) + touched.sum(dim=(1, 2)) - both
    there = (touched.sum(dim=(1, 2)) > 0).float()
    return (there * (1.0 - (both + 1.0) / (either + 1.0))).sum() / there.sum().clamp(min=1.0)
