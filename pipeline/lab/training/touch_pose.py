"""Task: an object's pose from a sensor's own touches, for the paper's tactile metric and the
encoder of touch sets.

All objects of the catalogue are trained on, the unseen tools of the translators included: this
network judges a touch, it is not judged. Touches are shown whole, in part and mixed, a bubble's
also rotated and mirrored as its camera and the object allow, and never as a translator generates
them: a network trained on whole touches alone reads a translated touch, which ends where the
source's view ends, as a smaller object elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.params import setting
from pipeline.lab.training.simulated_touches import (
    BUBBLE,
    find_next_contact,
    load_working_sensor,
    sample_depth_noise,
    simulate_target_touch,
)
from pipeline.lab.training.square_tasks import render_square
from pipeline.lab.training.task import VALIDATION_SEED, AugmentedPresses, TargetSensor, weigh_terms
from pipeline.physics.simulation import poses, shapes
from pipeline.stages.networks.touch_formats import SIDE, normalise

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.lab.training.task import Example, Split

_LEVER_MM = 10.0  # one radian of rotation weighs as this translation
_UNNAMED_SHARE = 0.25  # examples without the object's class
# errors below these count as squares
_HUBER_MM = 0.3
_HUBER_RAD = 0.05
# y -> -y maps all other objects of the catalogue onto themselves
_CHIRAL = ("letters", "cross", "wave")


@frozen
class TouchPoseTask(AugmentedPresses):
    """Settings of the examples and weights of the loss."""

    sensor: TargetSensor = setting(BUBBLE, "Sensor", choices=TargetSensor)
    name_weight: float = setting(
        0.3, "Class weight", low=0.0, high=100.0, help="of the object's class"
    )
    partial_share: float = setting(
        0.7,
        "Partial share",
        low=0.0,
        high=1.0,
        help="partial touches; half of them are mixed with the whole touch",
    )

    def sample(self, rng: np.random.Generator) -> Example:
        """A touch and its object's pose; a bubble's rotated or mirrored in a share of the
        examples.
        """
        index = int(rng.integers(self.n_presses))
        partial = rng.random() < self.partial_share
        whole_share = float(max(0.0, rng.uniform(-1.0, 1.0))) if partial else 1.0
        example = self._make_example(index, self.press_seed, whole_share, rng)
        if self.sensor == BUBBLE and rng.random() < self.augmentation_share:
            example = flip_touch(example, int(rng.integers(1, 4)))
        if rng.random() < _UNNAMED_SHARE:
            example["object_one_hot"] = np.zeros_like(example["object_one_hot"])
        return example

    def make_validation_example(self, split: Split, index: int) -> Example:  # noqa: ARG002
        """A touch in a new pose; every other one is partial. All objects are trained on."""
        return self._make_example(
            index // 2, VALIDATION_SEED, float(index % 2 == 0), np.random.default_rng([5, index])
        )

    def compute_loss(
        self, network: nn.Module, batch: Mapping[str, Tensor]
    ) -> tuple[Tensor, dict[str, Any]]:
        """Translation error, rotation error up to the object's symmetry, and cross entropy of
        the object's class.
        """
        from torch.nn import functional

        prediction = network(batch["square"], batch["object_one_hot"])
        truth = batch["truth"]
        if int(truth[:, 3].max()) > prediction.headings.shape[1]:
            raise SettingProblem(
                "n_folds of the network must be 6 to predict the rotation of a hexagon"
            )
        error = functional.huber_loss(prediction.translation_mm, truth[:, :2], delta=_HUBER_MM)
        rotation = compute_rotation_loss(prediction.headings, truth[:, 2], truth[:, 3]).mean()
        name = functional.cross_entropy(prediction.object_logits, truth[:, 4].long())
        return weigh_terms(
            {
                "translation": (1.0, error / _HUBER_MM),
                "rotation": (1.0, rotation),
                "class": (self.name_weight, name),
            }
        )

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Mean errors and accuracy of the object's class; partial touches by themselves."""
        import torch

        inputs = (
            torch.from_numpy(np.stack([e[key] for e in held_out]))
            for key in ("square", "object_one_hot")
        )
        with torch.inference_mode():
            prediction = network(*inputs)
        truth = np.stack([example["truth"] for example in held_out])
        _, _, true_angle, folds, label, whole = truth.T
        translation = np.hypot(*(prediction.translation_mm.numpy() - truth[:, :2]).T)
        fold = np.maximum(folds, 1.0)
        angle = _compute_angles(prediction.headings.numpy(), fold.astype(int)) - true_angle
        rotation = np.degrees(np.abs(np.angle(np.exp(1j * fold * angle))) / fold)
        correct = prediction.object_logits.numpy().argmax(1) == label
        metrics: dict[str, float] = {}
        for prefix, those in (("", whole == 1.0), ("partial ", whole != 1.0)):
            oriented = those & (folds > 0)
            if oriented.any():
                metrics[f"{prefix}translation error, mm"] = float(translation[those].mean())
                metrics[f"{prefix}rotation error, deg"] = float(rotation[oriented].mean())
                metrics[f"{prefix}object accuracy"] = float(correct[those].mean())
        return metrics

    def _make_example(
        self, index: int, seed: int, whole_share: float, rng: np.random.Generator
    ) -> Example:
        """Touch `index`, a bubble's with a share of its noise: a generated touch has less than a
        recorded one.

        `whole_share` 0 shows the part that a source observes alone, 1 the whole touch.
        """
        touch = find_next_contact(
            lambda k: simulate_target_touch(self.sensor, "all_objects", seed, k, self.folder), index
        )
        sensor = load_working_sensor(self.sensor)
        shown_mm = whole_share * touch.target_mm + (1.0 - whole_share) * touch.physical_mm
        if self.sensor == BUBBLE:
            shown_mm += rng.random() * sample_depth_noise(rng, shown_mm.shape)
        square = normalise(render_square(sensor, shown_mm.astype(np.float32), SIDE), sensor.kind)
        pose = touch.alignment_from_object
        names = shapes.list_labelled_shapes()
        label = names.index(touch.object_name)
        fold = shapes.make_shape(touch.object_name).symmetry.fold
        angle = math.atan2(pose[1, 0], pose[0, 0])
        return {
            "square": square,
            "object_one_hot": np.eye(len(names), dtype=np.float32)[label],
            "truth": np.array(
                (pose[0, 3], pose[1, 3], angle, fold, label, whole_share), np.float32
            ),
        }


def flip_touch(example: Example, which: int) -> Example:
    """A bubble's touch mirrored across x (1), across y (2) or rotated by 180 degrees (3).

    The centre is the camera's axis, not the middle of the image. The example itself comes back for
    an object that is not mirrored onto itself, and where the object would be held at an angle that
    does not occur.
    """
    import cv2

    x, y, angle, fold, label, whole = (float(v) for v in example["truth"])
    if which != 3 and shapes.list_labelled_shapes()[int(label)] in _CHIRAL:
        return example
    angle = {1: math.pi - angle, 2: -angle, 3: math.pi + angle}[which]
    angle = math.remainder(angle, 2.0 * math.pi / fold) if fold else 0.0
    if abs(angle) > math.radians(poses.MAX_ANGLE_DEG):
        return example
    camera = load_working_sensor(BUBBLE).camera
    side = example["square"].shape[-1]
    # 1 along an axis that stays, -1 along one that is reversed
    signs = np.array({1: (-1.0, 1.0), 2: (1.0, -1.0), 3: (-1.0, -1.0)}[which])
    axis_px = np.array([camera.cx_px, camera.cy_px])
    middle = (axis_px + 0.5) * side / np.array(camera.shape[::-1]) - 0.5
    matrix = np.column_stack([np.diag(signs), (1.0 - signs) * middle])
    square = example["square"][0]
    warped = cv2.warpAffine(square, matrix, (side, side), borderMode=cv2.BORDER_REPLICATE)
    truth = (*(signs * (x, y)), angle, fold, label, whole)
    return {
        **example,
        "square": np.asarray(warped, np.float32)[None],
        "truth": np.array(truth, np.float32),
    }


def compute_rotation_loss(headings: Tensor, angle_rad: Tensor, fold: Tensor) -> Tensor:
    """Rotation errors (n,) in mm at the lever, the least over an object's `fold`-fold symmetry.

    0 for fold 0.

    Compares unit vectors of the multiple of the angle, so that an uncertain prediction is a shorter
    vector.
    """
    import torch

    times = fold.clamp(min=1.0)
    predicted = headings[torch.arange(len(fold), device=fold.device), times.long() - 1]
    truth = torch.stack([torch.cos(times * angle_rad), torch.sin(times * angle_rad)], dim=1)
    error_sq = (predicted - truth).square().sum(1) / times**2
    cost = _LEVER_MM * ((error_sq + _HUBER_RAD**2).sqrt() - _HUBER_RAD)
    return torch.where(fold > 0, cost, torch.zeros_like(cost))


def _compute_angles(headings: Floats, fold: NDArray[Any]) -> Doubles:
    """Angles (n,) in rad from headings (n, folds, 2)."""
    cosine, sine = headings[np.arange(len(fold)), fold - 1].T
    return np.arctan2(sine, cosine).astype(np.float64) / fold
