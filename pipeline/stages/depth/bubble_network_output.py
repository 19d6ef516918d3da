"""What a network's answer to a bubble's reading means: lengths in mm and masks, for its teacher and its user alike."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pipeline.base.arrays import Floats

if TYPE_CHECKING:
    from torch import Tensor

N_OUTPUTS = 5
_LOG_SPREAD = (-6.0, 3.0)


class BubbleOutputTensors(NamedTuple):
    """What its teacher looks at: one value a pixel, each (n, rows, cols)."""

    displacement_mm: Tensor  # how far the membrane has moved toward the camera
    object_displacement_mm: (
        Tensor  # how far in the object's own surface lies: as much where it touches, less where it does not
    )
    log_error: Tensor  # log of the mean error to be expected of `object_mm`, of `moved_mm` beside it; mm
    contact: Tensor  # logit
    object_in_view: Tensor  # logit: the object is there, and near enough for its surface to be told


def decode_tensors(answer: Tensor, smooth_mm: Tensor) -> BubbleOutputTensors:
    """The fields of a network's answer (n, OUTPUTS, rows, cols) over the estimates (n, 1, rows, cols) it corrects."""
    from torch.nn import functional

    moved = smooth_mm[:, 0] + answer[:, 0]
    return BubbleOutputTensors(
        displacement_mm=moved,
        object_displacement_mm=moved - functional.softplus(answer[:, 1]),
        log_error=answer[:, 2].clamp(*_LOG_SPREAD),
        contact=answer[:, 3],
        object_in_view=answer[:, 4],
    )


class BubblePrediction(NamedTuple):
    """What its user looks at: one value a pixel, each (rows, cols)."""

    displacement_mm: Floats
    object_displacement_mm: Floats
    expected_error_mm: Floats  # as `log_spread`
    contact: Floats  # likelihood
    object_in_view: Floats  # likelihood


def decode_prediction(answer: Floats, smooth_mm: Floats) -> BubblePrediction:
    """As `fields`, of one answer (OUTPUTS, rows, cols) over the estimate (rows, cols) that it corrects."""
    moved = smooth_mm + answer[0]
    return BubblePrediction(
        displacement_mm=moved,
        object_displacement_mm=moved - np.logaddexp(np.float32(0.0), answer[1]),
        expected_error_mm=np.exp(np.clip(answer[2], *_LOG_SPREAD)),
        contact=_likelihood(answer[3]),
        object_in_view=_likelihood(answer[4]),
    )


def _likelihood(logit: Floats) -> Floats:
    """The sigmoid, which no logit makes overflow so."""
    return np.float32(0.5) + np.float32(0.5) * np.tanh(np.float32(0.5) * logit)
