"""Recorded pairs as touch to touch trains on them: the condition as in use, and the target's touch.

The target's touch is the recording's truth, or the depth estimated from its frame.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.stages.depth import photometric as depth
from pipeline.stages.touch import t2t
from pipeline.stages.touch.depth_condition import make_working_sensor
from pipeline.stages.touch.residual_render import resample_to_grid
from pipeline.training.recorded_pairs import RecordedPair
from pipeline.training.recorded_touches import derive_contact

_MAX_ROTATION_DEG, _MAX_SCALING, _MAX_TRANSLATION = 5.0, 0.05, 0.03  # the last in shares of the image's rows
_MAX_BRIGHTENING = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionedTouch:
    """A pair on the target's working grid."""

    condition: Floats  # (channels, rows, cols), see `stages.touch.image_condition`
    indentation_mm: Floats  # (rows, cols) of the target
    contact: Mask  # (rows, cols)


def condition_recorded_pair(pair: RecordedPair) -> ConditionedTouch | None:
    """The pair on the working grid; None where one of the sensors is untouched."""
    if depth.skip_without_contact(pair.source_frame, pair.source, None, depth.DepthParams()) is not None:
        return None
    truth = pair.target_truth
    if truth is not None and truth.indentation_mm is not None:
        touch, contact = truth.indentation_mm, derive_contact(truth, pair.target)
    else:
        if depth.skip_without_contact(pair.target_frame, pair.target, None, depth.DepthParams()) is not None:
            return None
        estimate = depth.estimate_depth(pair.target_frame, pair.target, None, depth.DepthParams())
        touch, contact = np.nan_to_num(estimate.indentation_mm), estimate.contact
    if not contact.any():
        return None
    shape = make_working_sensor(pair.target).camera.shape
    return ConditionedTouch(
        condition=t2t.build_condition(pair.source_frame, pair.source, pair.alignment, pair.target),
        indentation_mm=resample_to_grid(touch, shape), contact=resample_to_grid(contact, shape) > 0.5,
    )  # fmt: skip


def jitter_touch(touch: ConditionedTouch, rng: np.random.Generator) -> ConditionedTouch:
    """The pair slightly rotated, scaled and translated, its source's change stronger or weaker."""
    import cv2

    rows, cols = touch.contact.shape
    angle = math.radians(rng.uniform(-_MAX_ROTATION_DEG, _MAX_ROTATION_DEG))
    scale = 1.0 + rng.uniform(-_MAX_SCALING, _MAX_SCALING)
    across, down = rng.uniform(-_MAX_TRANSLATION, _MAX_TRANSLATION, 2) * rows
    cos, sin = scale * math.cos(angle), scale * math.sin(angle)
    x, y = (cols - 1) / 2, (rows - 1) / 2
    matrix = np.array([[cos, -sin, x - cos * x + sin * y + across], [sin, cos, y - sin * x - cos * y + down]])

    def warp(field: Any) -> Floats:
        return np.asarray(cv2.warpAffine(np.asarray(field, np.float32), matrix, (cols, rows), flags=cv2.INTER_LINEAR,
                                         borderMode=cv2.BORDER_REPLICATE), np.float32)  # fmt: skip

    condition = np.stack([warp(channel) for channel in touch.condition])
    condition[:-1] *= np.float32(1.0 + rng.uniform(-_MAX_BRIGHTENING, _MAX_BRIGHTENING))  # the last channel is a mask
    return ConditionedTouch(
        condition=freeze(condition),
        indentation_mm=freeze(warp(touch.indentation_mm)),
        contact=freeze(warp(touch.contact) > 0.5),
    )
