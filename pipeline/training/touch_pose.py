"""To tell an object's pose from a sensor's own touches: the paper's tactile metric, and the encoder of sets of touches.

All objects of the catalogue are learned, the tools that translators never see among them: what is judged by this is a
touch, not this. A bubble's touches are shown whole, in part (`part_touches`) and between the two, and turned and
mirrored as its camera and the object allow: more than is pressed, and nothing that a translator made.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, Floats
from pipeline.base.errors import SettingProblem
from pipeline.base.params import setting
from pipeline.networks.square_images import normalise
from pipeline.simulation import poses, shapes
from pipeline.training.partial_touches import simulate_partial_touch
from pipeline.training.touch_squares import PairedDataSplit, load_nominal_sensors, simulate_touch_squares

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.task import Example, Split

TouchSensor = Literal["gelslim", "soft_bubble"]
_HELD_OUT_SEED = 7
_TURN_MM = 10.0  # lever of a turn: what a radian counts for beside a shift
_SHARP_MM, _SHARP_RAD = 0.3, 0.05  # errors below these count as their square
_CHIRAL = ("letters", "cross", "wave")  # all other objects of the catalogue are mirrored by y -> -y onto themselves


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchPoseTask:
    """Whose touches, and what counts for how much."""

    sensor: TouchSensor = setting("soft_bubble", "Sensor", choices=TouchSensor)
    n_presses: int = setting(
        2000, "Presses", low=1, high=10_000_000, help="of all objects, that examples are drawn from"
    )
    n_paired_presses: int = setting(
        0, "Presses of pairs", low=0, high=10_000_000, help="of training objects, drawn from as well"
    )
    press_seed: int = setting(1, "Seed of the presses", low=0, high=2**31 - 1)
    folder: str = setting("", "Folder", help="keeps the presses for other runs; empty = worked out each time")
    name_weight: float = setting(0.3, "Weight of the object's name", low=0.0, high=100.0)
    partial_share: float = setting(
        0.7, "Share in part", low=0.0, high=1.0, help="of `presses`; half are mixed with the whole"
    )
    augmentation_share: float = setting(
        0.5, "Share of turned and mirrored touches", low=0.0, high=1.0, help="of a bubble"
    )
    unnamed_share: float = setting(0.25, "Share of touches whose object is not said", low=0.0, high=1.0)

    def sample(self, rng: np.random.Generator) -> Example:
        """A touch and where its object is."""
        index = int(rng.integers(self.n_presses + self.n_paired_presses))
        of: tuple[PairedDataSplit, int] = ("own", index) if index < self.n_presses else ("learned", self._named(index))
        in_part = of[0] == "own" and rng.random() < self.partial_share
        whole = float(max(0.0, rng.uniform(-1.0, 1.0))) if in_part else 1.0
        example = self._example(*of, self.press_seed, float(rng.random()), whole)
        if self.sensor == "soft_bubble" and rng.random() < self.augmentation_share:
            example = flip_touch(example, int(rng.integers(1, 4)))
        if rng.random() < self.unnamed_share:
            example["known"] = np.zeros_like(example["known"])
        return example

    def _named(self, index: int) -> int:
        """The touch of pairs that translators learn from at or behind that one whose object has a name."""
        found = index - self.n_presses
        while not simulate_touch_squares("learned", self.press_seed, found, self.folder).object_name:
            found += 1
        return found

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A touch as no object was ever held; of a bubble every other one in part."""
        in_part = self.sensor == "soft_bubble" and index % 2 == 1
        number = index // 2 if self.sensor == "soft_bubble" else index
        return self._example(split, number, _HELD_OUT_SEED, 1.0, float(not in_part))

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """How far off the shift is and the turn, up to the object's symmetry, and how likely its name."""
        from torch.nn import functional

        told, truth = network(batch["square"], batch["known"]), batch["truth"]
        if int(truth[:, 3].max()) > told.headings.shape[1]:
            raise SettingProblem("folds of the network must be 6, or it cannot tell the turn of a hexagon")
        shift = functional.huber_loss(told.translation_mm, truth[:, :2], delta=_SHARP_MM) / _SHARP_MM
        turn = compute_rotation_loss(told.headings, truth[:, 2], truth[:, 3]).mean()
        name = functional.cross_entropy(told.object_logits, truth[:, 4].long())
        loss = shift + turn + self.name_weight * name
        return loss, {"shift": shift.detach(), "turn": turn.detach(), "name": name.detach()}

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Mean errors and how often the object is named; of touches in part by themselves."""
        import torch

        squares, known = (torch.from_numpy(np.stack([one[key] for one in held_out])) for key in ("square", "known"))
        with torch.inference_mode():
            told = network(squares, known)
        truth = np.stack([one["truth"] for one in held_out])
        shift = np.hypot(*(told.translation_mm.numpy() - truth[:, :2]).T)
        fold = np.maximum(truth[:, 3], 1.0)
        angle = _angles(told.headings.numpy(), fold.astype(int)) - truth[:, 2]
        off = np.degrees(np.abs(np.angle(np.exp(1j * fold * angle))) / fold)
        named = told.object_logits.numpy().argmax(1) == truth[:, 4]
        found: dict[str, float] = {}
        for end, those in (("", truth[:, 5] == 1.0), (" in part", truth[:, 5] != 1.0)):
            seen = those & (truth[:, 3] > 0)
            if seen.any():
                found[f"shift{end}, mm"], found[f"turn{end}, deg"] = float(shift[those].mean()), float(off[seen].mean())
                found[f"named{end}"] = float(named[those].mean())
        return found

    def _example(self, things: PairedDataSplit, index: int, seed: int, noise: float, whole: float) -> Example:
        """Touch `index` with so much of its noise, and so much of it that is not of its part."""
        touch = simulate_touch_squares(things, seed, index, self.folder)
        if self.sensor == "gelslim":
            whole, square = 1.0, normalise(touch.nominal_gel_change, "gel")
        else:  # what is generated has less noise than what is recorded
            seen = touch.exact_imprint_mm + np.float32(noise) * (touch.bubble_imprint_mm - touch.exact_imprint_mm)
            if whole < 1.0:
                less = simulate_partial_touch(things, seed, index, self.folder).imprint_mm
                seen = np.float32(whole) * seen + np.float32(1.0 - whole) * (less if less.any() else seen)
            square = normalise(seen.astype(np.float32), "bubble")
        pose, label = touch.alignment_from_object, shapes.list_labelled_shapes().index(touch.object_name)
        turn = math.atan2(pose[1, 0], pose[0, 0])
        known = np.zeros(len(shapes.list_labelled_shapes()), np.float32)
        known[label] = 1.0
        place = (pose[0, 3], pose[1, 3], turn, shapes.make_shape(touch.object_name).symmetry.fold, label, whole)
        return {"square": square, "known": known, "truth": np.array(place, np.float32)}


def flip_touch(example: Example, way: int) -> Example:
    """A bubble's touch mirrored across x (1), across y (2) or turned by half (3); itself where the object has no such.

    As its camera sees it: about the point that it looks straight at, which is not the middle of its picture.
    """
    import cv2

    x, y, turn, fold, label, whole = (float(v) for v in example["truth"])
    if way != 3 and shapes.list_labelled_shapes()[int(label)] in _CHIRAL:
        return example
    turn = {1: math.pi - turn, 2: -turn, 3: math.pi + turn}[way]
    share = 2.0 * math.pi / fold if fold else math.inf
    turn = math.remainder(turn, share) if fold else 0.0
    if abs(turn) > math.radians(poses.MAX_ANGLE_DEG):
        return example  # never held so
    camera, square = load_nominal_sensors()[1].camera, example["square"]
    side = square.shape[-1]
    middle_x = (camera.cx_px + 0.5) * side / camera.cols - 0.5
    middle_y = (camera.cy_px + 0.5) * side / camera.rows - 0.5
    over_x, over_y = way in (1, 3), way in (2, 3)
    how = np.array([[-1.0, 0.0, 2.0 * middle_x] if over_x else [1.0, 0.0, 0.0],
                    [0.0, -1.0, 2.0 * middle_y] if over_y else [0.0, 1.0, 0.0]])  # fmt: skip
    laid = cv2.warpAffine(square[0], how, (side, side), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    place = (-x if over_x else x, -y if over_y else y, turn, fold, label, whole)
    return {**example, "square": np.asarray(laid, np.float32)[None], "truth": np.array(place, np.float32)}


def compute_rotation_loss(headings: Tensor, turn_rad: Tensor, fold: Tensor) -> Tensor:
    """(n,) error of a turn in mm at the lever, least over an object's symmetry of that `fold`; 0 = any turn is right.

    The vector of its multiple of the angle is compared, so that what is not known comes out short.
    """
    import torch

    times = fold.clamp(min=1.0)
    told = headings[torch.arange(len(fold), device=fold.device), times.long() - 1]
    truth = torch.stack([torch.cos(times * turn_rad), torch.sin(times * turn_rad)], dim=1)
    off = (told - truth).square().sum(1) / times**2
    cost = _TURN_MM * ((off + _SHARP_RAD**2).sqrt() - _SHARP_RAD)
    return torch.where(fold > 0, cost, torch.zeros_like(cost))


def _angles(headings: Floats, fold: NDArray[Any]) -> Doubles:
    """(n,) rad, of objects of those symmetries."""
    cosine, sine = headings[np.arange(len(fold)), fold - 1].T
    return np.arctan2(sine, cosine).astype(np.float64) / fold
