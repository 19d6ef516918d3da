"""What a network's answer to a bubble's reading means: lengths in mm and masks, for its teacher and its user alike."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from torch import Tensor

OUTPUTS = 5
_LOG_SPREAD = (-6.0, 3.0)


class Fields(NamedTuple):
    """One value a pixel, each (n, rows, cols)."""

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
