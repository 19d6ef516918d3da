"""What a network's answer to a bubble's reading means: lengths in mm and masks, for its teacher and its user alike."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pipeline.base.arrays import Floats

if TYPE_CHECKING:
    from torch import Tensor

OUTPUTS = 5
_LOG_SPREAD = (-6.0, 3.0)


class Fields(NamedTuple):
    """What its teacher looks at: one value a pixel, each (n, rows, cols)."""

    moved_mm: Tensor  # how far the membrane has moved toward the camera
    object_mm: Tensor  # how far in the object's own surface lies: as much where it touches, less where it does not
    log_spread: Tensor  # log of the mean error to be expected of `object_mm`, of `moved_mm` beside it; mm
    contact: Tensor  # logit
    told: Tensor  # logit: the object is there, and near enough for its surface to be told


def fields(answer: Tensor, smooth_mm: Tensor) -> Fields:
    """The fields of a network's answer (n, OUTPUTS, rows, cols) over the estimates (n, 1, rows, cols) it corrects."""
    from torch.nn import functional

    moved = smooth_mm[:, 0] + answer[:, 0]
    return Fields(
        moved_mm=moved,
        object_mm=moved - functional.softplus(answer[:, 1]),
        log_spread=answer[:, 2].clamp(*_LOG_SPREAD),
        contact=answer[:, 3],
        told=answer[:, 4],
    )


class Found(NamedTuple):
    """What its user looks at: one value a pixel, each (rows, cols)."""

    moved_mm: Floats
    object_mm: Floats
    spread_mm: Floats  # as `log_spread`
    contact: Floats  # likelihood
    told: Floats  # likelihood


def found(answer: Floats, smooth_mm: Floats) -> Found:
    """As `fields`, of one answer (OUTPUTS, rows, cols) over the estimate (rows, cols) that it corrects."""
    moved = smooth_mm + answer[0]
    return Found(
        moved_mm=moved,
        object_mm=moved - np.logaddexp(np.float32(0.0), answer[1]),
        spread_mm=np.exp(np.clip(answer[2], *_LOG_SPREAD)),
        contact=_likelihood(answer[3]),
        told=_likelihood(answer[4]),
    )


def _likelihood(logit: Floats) -> Floats:
    """The sigmoid, which no logit makes overflow so."""
    return np.float32(0.5) + np.float32(0.5) * np.tanh(np.float32(0.5) * logit)
