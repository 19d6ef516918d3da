"""Task of touch to touch: the target's touch from the source's frame, trained on simulated
pairs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.core.arrays import Floats, Mask, freeze
from pipeline.lab.training.denoising import DenoisingTask
from pipeline.lab.training.object_sampling import DataSplit, find_next_contact
from pipeline.lab.training.recorded_pairs import RecordedPair, derive_contact
from pipeline.lab.training.task import VALIDATION_SEED, augmentation_setting
from pipeline.lab.training.touch_pairs import (
    BUBBLE,
    GEL,
    TouchPair,
    mirror_pair,
    place_nominal_sensors,
    simulate_touch_pair,
)
from pipeline.lab.training.touch_residual import make_residual_example
from pipeline.sensors import alignment
from pipeline.stages.depth import photometric as depth
from pipeline.stages.touch import t2t
from pipeline.stages.touch.depth_condition import make_working_sensor
from pipeline.stages.touch.image_condition import build_image_condition
from pipeline.stages.touch.residual_render import resample_to_grid

if TYPE_CHECKING:
    from pipeline.lab.training.task import Example, Split

# the last in shares of the image's rows
_MAX_ROTATION_DEG = 5.0
_MAX_SCALING = 0.05
_MAX_TRANSLATION = 0.03
_MAX_BRIGHTENING = 0.25
GELS = (GEL, "gelsight_mini")  # sources of training pairs, and the share of the second
_OTHER_GEL_SHARE = 0.25
_DRIFT_GREY = 2.0  # standard deviation of a change of light since the reference image


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionedTouch:
    """A pair on the target's working grid."""

    condition: Floats  # (channels, rows, cols), see `stages.touch.image_condition`
    indentation_mm: Floats  # (rows, cols) of the target
    contact: Mask  # (rows, cols)


def condition_recorded_pair(pair: RecordedPair) -> ConditionedTouch | None:
    """The pair on the working grid; None where one of the sensors is untouched."""
    if (
        depth.skip_without_contact(pair.source_frame, pair.source, None, depth.DepthParams())
        is not None
    ):
        return None
    truth = pair.target_truth
    if truth is not None and truth.indentation_mm is not None:
        touch = truth.indentation_mm
        contact = derive_contact(truth, pair.target)
    else:
        if (
            depth.skip_without_contact(pair.target_frame, pair.target, None, depth.DepthParams())
            is not None
        ):
            return None
        estimate = depth.estimate_depth(pair.target_frame, pair.target, None, depth.DepthParams())
        touch = np.nan_to_num(estimate.indentation_mm)
        contact = estimate.contact
    if not contact.any():
        return None
    shape = make_working_sensor(pair.target).camera.shape
    return ConditionedTouch(
        condition=t2t.build_condition(pair.source_frame, pair.source, pair.alignment, pair.target),
        indentation_mm=resample_to_grid(touch, shape),
        contact=resample_to_grid(contact, shape) > 0.5,
    )


def jitter_touch(touch: ConditionedTouch, rng: np.random.Generator) -> ConditionedTouch:
    """The pair slightly rotated, scaled and translated, its source's change stronger or weaker."""
    import cv2

    rows, cols = touch.contact.shape
    angle = math.radians(rng.uniform(-_MAX_ROTATION_DEG, _MAX_ROTATION_DEG))
    scale = 1.0 + rng.uniform(-_MAX_SCALING, _MAX_SCALING)
    across, down = rng.uniform(-_MAX_TRANSLATION, _MAX_TRANSLATION, 2) * rows
    cos = scale * math.cos(angle)
    sin = scale * math.sin(angle)
    x = (cols - 1) / 2
    y = (rows - 1) / 2
    matrix = np.array(
        [[cos, -sin, x - cos * x + sin * y + across], [sin, cos, y - sin * x - cos * y + down]]
    )

    def warp(field: Any) -> Floats:
        return np.asarray(
            cv2.warpAffine(
                np.asarray(field, np.float32),
                matrix,
                (cols, rows),
                flags=cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REPLICATE,
            ),
            np.float32,
        )

    condition = np.stack([warp(channel) for channel in touch.condition])
    # view and overlap are no colours
    condition[:-2] *= np.float32(1.0 + rng.uniform(-_MAX_BRIGHTENING, _MAX_BRIGHTENING))
    return ConditionedTouch(
        condition=freeze(condition),
        indentation_mm=freeze(warp(touch.indentation_mm)),
        contact=freeze(warp(touch.contact) > 0.5),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchToTouchTask(DenoisingTask):
    """Settings of the examples and weights of the loss; from a gel to a bubble."""

    augmentation_share: float = augmentation_setting(
        help="mirrored examples, three in four of them with a new image"
    )

    @property
    def kind(self) -> str:
        """Kind of the target."""
        return "bubble"

    def sample(self, rng: np.random.Generator) -> Example:
        """A pair whose image is stronger or weaker and has drifted, mirrored in a share of the
        examples.

        A mirrored gel's image is rendered anew, as its LEDs are asymmetric.
        """
        import cv2

        gel = GELS[int(rng.random() < _OTHER_GEL_SHARE)]
        pair = self._get_pair("training", self.press_seed, int(rng.integers(self.n_presses)), gel)
        if rng.random() < self.augmentation_share:
            pair = mirror_pair(pair, rng, gel)
        grey = pair.change_grey
        drift = cv2.resize(rng.normal(0.0, _DRIFT_GREY, (2, 3, 3)), grey.shape[1::-1])
        strength = 1.0 + rng.uniform(-_MAX_BRIGHTENING, _MAX_BRIGHTENING)
        recorded = (strength * grey + drift).astype(np.float32)
        return self._make_example(replace(pair, change_grey=recorded), rng, gel)

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A training object in a new pose, or an unseen tool."""
        return self._make_example(
            self._get_pair(split, VALIDATION_SEED, index), np.random.default_rng([17, index])
        )

    @property
    def pair_sensors(self) -> tuple[str, str]:
        """Names of source and target."""
        return GEL, BUBBLE

    def prepare_pair(self, pair: RecordedPair) -> ConditionedTouch | None:
        """Condition and true touch of a recorded pair."""
        return condition_recorded_pair(pair)

    def make_pair_example(
        self, prepared: ConditionedTouch, rng: np.random.Generator, *, is_validation: bool
    ) -> Example:
        """A recorded pair, moved, rotated and brightened a little unless it validates."""
        touch = prepared if is_validation else jitter_touch(prepared, rng)
        no_contact = np.zeros(touch.contact.shape, np.bool_)
        return make_residual_example(
            touch.condition, touch.indentation_mm, touch.contact, no_contact, self.kind
        )

    def _get_pair(self, split: DataSplit, seed: int, index: int, gel: str = GEL) -> TouchPair:
        """Pair `index`, or the next one with contact on the gel."""
        return find_next_contact(
            lambda k: simulate_touch_pair(split, seed, k, self.folder, gel=gel),
            index,
            "the gel has no contact in",
        )

    def _make_example(
        self, pair: TouchPair, rng: np.random.Generator, gel_name: str = GEL
    ) -> Example:
        gel, bubble = place_nominal_sensors(pair.placement, gel_name)
        change = pair.change_grey + rng.normal(0.0, 1.0, pair.change_grey.shape).astype(np.float32)
        between = alignment.resolve_alignment(gel, bubble)
        condition = build_image_condition(change, gel.camera, gel, bubble, between)
        no_contact = np.zeros(pair.bubble_contact.shape, np.bool_)
        return make_residual_example(
            condition, pair.bubble_mm, pair.bubble_contact, no_contact, self.kind
        )
