"""The scale-invariant logarithmic loss of the paper (Eigen et al. 2014), in a form that has a gradient everywhere."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

_EPS = 1e-8  # under the root: a perfect answer has a gradient of zero, not of no number


def compute_silog_loss(found: Tensor, truth: Tensor, counted: Tensor, *, share: float, least: float) -> Tensor:
    """Mean over the pictures (n, rows, cols) of sqrt(mean d^2 - share mean(d)^2), d = log found - log truth.

    Only `counted` pixels (n, rows, cols, 0 or 1) enter, and pictures that have any; both depths are cut off below at
    `least`. It is written as variance + (1 - share) mean^2, which rounding cannot make negative.
    """
    import torch

    found, truth = found.float().clamp(min=least), truth.float().clamp(min=least)
    apart = (torch.log(found) - torch.log(truth)) * counted
    n = counted.sum((1, 2))
    mean = apart.sum((1, 2)) / n.clamp(min=1.0)
    variance = ((apart - mean[:, None, None]) ** 2 * counted).sum((1, 2)) / n.clamp(min=1.0)
    each = torch.sqrt(variance + (1.0 - share) * mean**2 + _EPS)
    some = (n > 0).float()
    return (each * some).sum() / some.sum().clamp(min=1.0)
