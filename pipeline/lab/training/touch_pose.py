"""Task: an object's pose from a sensor's own touches, for the paper's tactile metric and the
encoder of touch sets.

All objects of the catalogue are trained on, the unseen tools of the translators included: this
network judges a touch, it is not judged. A bubble's touches are shown whole, in part
(`PartialTouch`) and mixed, rotated and mirrored as its camera and the object allow, and never as a
translator generates them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats
from pipeline.core.derived import derive_once
from pipeline.core.errors import SettingProblem
from pipeline.core.geometry import rigid
from pipeline.core.geometry.rasterisation import render_mesh
from pipeline.core.params import setting
from pipeline.lab.training.object_sampling import DATA_SPLITS, DataSplit, SampleCache
from pipeline.lab.training.source_observation import simulate_source_observation
from pipeline.lab.training.target_touches import make_target_depth
from pipeline.lab.training.task import VALIDATION_SEED, SimulatedPresses, augmentation_setting
from pipeline.lab.training.touch_squares import load_nominal_sensors, simulate_touch_squares
from pipeline.physics.simulation import poses, shapes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.networks.touch_formats import normalise, resize_to_square
from pipeline.stages.touch.physical_render import PhysicalRenderParams, render_touch
from pipeline.stages.touch.t2d2 import make_working_sensor

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.lab.training.task import Example, Split


TouchSensor = Literal["gelslim", "soft_bubble"]
_LEVER_MM = 10.0  # one radian of rotation weighs as this translation
# errors below these count as squares
_HUBER_MM = 0.3
_HUBER_RAD = 0.05
# y -> -y maps all other objects of the catalogue onto themselves
_CHIRAL = ("letters", "cross", "wave")


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchPoseTask(SimulatedPresses):
    """Settings of the examples and weights of the loss."""

    sensor: TouchSensor = setting("soft_bubble", "Sensor", choices=TouchSensor)
    n_paired_presses: int = setting(
        0,
        "Paired presses",
        low=0,
        high=10_000_000,
        help="further presses, of the training objects of pairs",
    )
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
    augmentation_share: float = augmentation_setting(help="rotated or mirrored touches of a bubble")
    unnamed_share: float = setting(
        0.25, "Unnamed share", low=0.0, high=1.0, help="examples without the object's class"
    )

    def sample(self, rng: np.random.Generator) -> Example:
        """A touch and its object's pose."""
        index = int(rng.integers(self.n_presses + self.n_paired_presses))
        paired = index >= self.n_presses
        split: DataSplit = "training" if paired else "all_objects"
        number = self._find_named(index - self.n_presses) if paired else index
        partial = not paired and rng.random() < self.partial_share
        whole_share = float(max(0.0, rng.uniform(-1.0, 1.0))) if partial else 1.0
        example = self._make_example(
            split, number, self.press_seed, float(rng.random()), whole_share
        )
        if self.sensor == "soft_bubble" and rng.random() < self.augmentation_share:
            example = flip_touch(example, int(rng.integers(1, 4)))
        if rng.random() < self.unnamed_share:
            example["object_one_hot"] = np.zeros_like(example["object_one_hot"])
        return example

    def _find_named(self, index: int) -> int:
        """The first paired press from `index` on whose object is of the catalogue."""
        while not simulate_touch_squares(
            "training", self.press_seed, index, self.folder
        ).object_name:
            index += 1
        return index

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A touch in a new pose; of a bubble every other one is partial."""
        if self.sensor == "gelslim":
            return self._make_example(split, index, VALIDATION_SEED, 1.0, 1.0)
        return self._make_example(split, index // 2, VALIDATION_SEED, 1.0, float(index % 2 == 0))

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
        translation = (
            functional.huber_loss(prediction.translation_mm, truth[:, :2], delta=_HUBER_MM)
            / _HUBER_MM
        )
        rotation = compute_rotation_loss(prediction.headings, truth[:, 2], truth[:, 3]).mean()
        name = functional.cross_entropy(prediction.object_logits, truth[:, 4].long())
        loss = translation + rotation + self.name_weight * name
        return loss, {
            "translation": translation.detach(),
            "rotation": rotation.detach(),
            "class": name.detach(),
        }

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
        translation = np.hypot(*(prediction.translation_mm.numpy() - truth[:, :2]).T)
        fold = np.maximum(truth[:, 3], 1.0)
        angle = _compute_angles(prediction.headings.numpy(), fold.astype(int)) - truth[:, 2]
        rotation = np.degrees(np.abs(np.angle(np.exp(1j * fold * angle))) / fold)
        correct = prediction.object_logits.numpy().argmax(1) == truth[:, 4]
        metrics: dict[str, float] = {}
        for prefix, those in (("", truth[:, 5] == 1.0), ("partial ", truth[:, 5] != 1.0)):
            oriented = those & (truth[:, 3] > 0)
            if oriented.any():
                metrics[f"{prefix}translation error, mm"] = float(translation[those].mean())
                metrics[f"{prefix}rotation error, deg"] = float(rotation[oriented].mean())
                metrics[f"{prefix}object accuracy"] = float(correct[those].mean())
        return metrics

    def _make_example(
        self, split: DataSplit, index: int, seed: int, noise_share: float, whole_share: float
    ) -> Example:
        """Touch `index` with a share of its noise.

        `whole_share` 0 shows its part alone, 1 the whole touch.
        """
        touch = simulate_touch_squares(split, seed, index, self.folder)
        if self.sensor == "gelslim":
            whole_share = 1.0
            square = normalise(touch.nominal_gel_change, "gel")
        else:  # a generated touch has less noise than a recorded one
            noise = touch.bubble_imprint_mm - touch.exact_imprint_mm
            imprint = touch.exact_imprint_mm + np.float32(noise_share) * noise
            if whole_share < 1.0:
                part = simulate_partial_touch(split, seed, index, self.folder).imprint_mm
                part = part if part.any() else imprint
                imprint = np.float32(whole_share) * imprint + np.float32(1.0 - whole_share) * part
            square = normalise(imprint.astype(np.float32), "bubble")
        pose = touch.alignment_from_object
        names = shapes.list_labelled_shapes()
        label = names.index(touch.object_name)
        angle = math.atan2(pose[1, 0], pose[0, 0])
        one_hot = np.zeros(len(names), np.float32)
        one_hot[label] = 1.0
        fold = shapes.make_shape(touch.object_name).symmetry.fold
        truth = np.array((pose[0, 3], pose[1, 3], angle, fold, label, whole_share), np.float32)
        return {"square": square, "object_one_hot": one_hot, "truth": truth}


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
    camera = load_nominal_sensors()[1].camera
    square = example["square"]
    side = square.shape[-1]
    middle_x = (camera.cx_px + 0.5) * side / camera.cols - 0.5
    middle_y = (camera.cy_px + 0.5) * side / camera.rows - 0.5
    flip_x = which in (1, 3)
    flip_y = which in (2, 3)
    matrix = np.array(
        [
            [-1.0, 0.0, 2.0 * middle_x] if flip_x else [1.0, 0.0, 0.0],
            [0.0, -1.0, 2.0 * middle_y] if flip_y else [0.0, 1.0, 0.0],
        ]
    )
    warped = cv2.warpAffine(
        square[0], matrix, (side, side), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    truth = (-x if flip_x else x, -y if flip_y else y, angle, fold, label, whole)
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


VERSION = 2  # part of the seeds: incremented when the same number gives another part
_TOLERANCE_UM = 20.0  # of the physical render: a square's pixels are coarser


@dataclass(frozen=True, slots=True, kw_only=True)
class PartialTouch:
    """The imprint of the observed part of a bubble's touch: a gel's window, a slice of its surface.

    A pose network trained on whole touches alone reads a translated touch, which ends where the
    source's view ends, as a smaller object elsewhere. No source is simulated and no generated touch
    is used: the observation is sampled (`source_observation`) and the bubble's physics renders it.
    """

    imprint_mm: Floats  # (1, side, side); 0 where nothing of the object is observed


_parts = SampleCache(PartialTouch, max_bytes=1 << 29)


def simulate_partial_touch(
    split: DataSplit, seed: int, index: int, folder: str = ""
) -> PartialTouch:
    """A part of that touch of `touch_squares`, whose object must be of the catalogue.

    The same on every call.
    """
    return _parts.get(
        f"part_{split}_{seed}_{index}", folder, lambda: _simulate_part(split, seed, index, folder)
    )


def _simulate_part(split: DataSplit, seed: int, index: int, folder: str) -> PartialTouch:
    rng = np.random.default_rng([VERSION, 19, DATA_SPLITS.index(split), seed, index])
    touch = simulate_touch_squares(split, seed, index, folder)
    bubble = _load_working_bubble()
    mesh = shapes.make_shape(touch.object_name).mesh
    vertices = rigid.apply(
        rigid.invert(bubble.alignment_from_sensor) @ touch.alignment_from_object, mesh.vertices_mm
    )
    surface = render_mesh(vertices, mesh.triangles, bubble.camera)[0]
    view = make_target_depth(
        bubble, simulate_source_observation(rng, surface, bubble, gel_share=1.0)
    )
    membrane = render_touch(view, bubble, PhysicalRenderParams(tolerance_um=_TOLERANCE_UM)).membrane
    assert membrane is not None
    return PartialTouch(imprint_mm=resize_to_square(membrane.indentation_mm[..., None]))


@derive_once
def _load_working_bubble() -> SensorSpec:
    return make_working_sensor(load_nominal_sensors()[1])
