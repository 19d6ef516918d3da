"""What the network that corrects physics is judged by while it learns."""

# ruff: noqa: TID253 (imported where a loss is asked for)
from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from pipeline.networks.gel_reading import Reading

_SHALLOW_PX, _DEPTH_SHARE = 0.6, 0.2  # an error weighs by what the touch is deep, and no more than this
_INSIDE, _BESIDE = 3.0, 0.7
_SLOPES, _CONTACT, _OVERLAP, _SPREAD = 5.0, 0.5, 0.3, 0.05


def loss(reading: Reading, indentation: Tensor, contact: Tensor) -> tuple[Tensor, dict[str, Any]]:
    """The loss and its parts; indentation (n, rows, cols) in pixels, contact (n, rows, cols) 0 or 1."""
    touched = contact.float()
    scale = _SHALLOW_PX + _DEPTH_SHARE * indentation.amax(dim=(1, 2), keepdim=True)
    weight = (_BESIDE + (_INSIDE - _BESIDE) * touched) / scale
    off = (reading.surface - indentation).abs()
    surface = (weight * off).mean()
    slopes = 0.5 * (
        (weight[..., 1:] * (_across(reading.surface) - _across(indentation)).abs()).mean()
        + (weight[..., 1:, :] * (_down(reading.surface) - _down(indentation)).abs()).mean()
    )
    told = functional.binary_cross_entropy_with_logits(reading.contact, touched)
    overlap = _overlap(torch.sigmoid(reading.contact), touched)
    spread = (off.detach() * torch.exp(-reading.log_spread) + reading.log_spread).mean()
    whole = surface + _SLOPES * slopes + _CONTACT * told + _OVERLAP * overlap + _SPREAD * spread
    parts = {"surface": surface, "slopes": slopes, "contact": told, "overlap": overlap, "spread": spread}
    return whole, {name: part.detach() for name, part in parts.items()}


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
