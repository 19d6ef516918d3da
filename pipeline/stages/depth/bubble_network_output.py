"""Decoding of the bubble network's outputs: lengths in mm, probabilities, masks.

For training and for prediction.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pipeline.core.arrays import Floats

if TYPE_CHECKING:
    from torch import Tensor

N_OUTPUTS = 5
_LOG_ERROR_RANGE = (-6.0, 3.0)


class BubbleOutputTensors(NamedTuple):
    """Decoded outputs in training, each (n, rows, cols)."""

    displacement_mm: Tensor  # of the membrane, toward the camera
    # of the object's surface: equal to it in contact, less elsewhere
    object_displacement_mm: Tensor
    # log of the mean error in mm: of the object's surface in view, of the membrane elsewhere
    log_error: Tensor
    contact: Tensor  # logit
    # logit: the object is there, near enough for its surface to be predicted
    object_in_view: Tensor


def decode_tensors(output: Tensor, smooth_mm: Tensor) -> BubbleOutputTensors:
    """Decoded outputs (n, N_OUTPUTS, rows, cols), which correct smooth displacements (n, 1,
    rows, cols).
    """
    from torch.nn import functional

    moved = smooth_mm[:, 0] + output[:, 0]
    return BubbleOutputTensors(
        displacement_mm=moved,
        object_displacement_mm=moved - functional.softplus(output[:, 1]),
        log_error=output[:, 2].clamp(*_LOG_ERROR_RANGE),
        contact=output[:, 3],
        object_in_view=output[:, 4],
    )


class BubblePrediction(NamedTuple):
    """Decoded outputs of one frame, each (rows, cols).

    As `BubbleOutputTensors`, but with a probability; what training alone reads is left out.
    """

    displacement_mm: Floats
    object_displacement_mm: Floats
    expected_error_mm: Floats
    contact: Floats  # probability


def decode_prediction(output: Floats, smooth_mm: Floats) -> BubblePrediction:
    """As `decode_tensors`, of one output (N_OUTPUTS, rows, cols) and its smooth displacement
    (rows, cols).
    """
    moved = smooth_mm + output[0]
    return BubblePrediction(
        displacement_mm=moved,
        object_displacement_mm=moved - np.logaddexp(np.float32(0.0), output[1]),
        expected_error_mm=np.exp(np.clip(output[2], *_LOG_ERROR_RANGE)),
        contact=_compute_sigmoid(output[3]),
    )


def _compute_sigmoid(logit: Floats) -> Floats:
    """The sigmoid by tanh, which does not overflow."""
    return np.float32(0.5) + np.float32(0.5) * np.tanh(np.float32(0.5) * logit)
