"""Task: what presses on a bubble's membrane, and where, from two noisy depth frames.

Objects of the catalogue and random bodies press on sensor instances that differ. The contact
depends on a number alone and is cached; the depth camera's noise is sampled on every use.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.core.arrays import Floats, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.core.frozen import frozen
from pipeline.core.geometry import membrane, rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.geometry.rasterisation import render_mesh
from pipeline.core.params import setting
from pipeline.lab.training.simulated_touches import (
    DATA_SPLITS,
    DataSplit,
    SampleCache,
    sample_object,
)
from pipeline.lab.training.task import VALIDATION_SEED, SimulatedPresses, average_rows, weigh_terms
from pipeline.physics import bubble
from pipeline.physics.simulation import poses, variation
from pipeline.physics.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.physics.simulation.poses import DEPTH_RANGE_MM
from pipeline.physics.simulation.press import move_bubble_closer, simulate_press
from pipeline.sensors.parts import Bubble
from pipeline.sensors.spec import DepthCamera, SensorSpec, load_sensor
from pipeline.stages.depth.bubble_depth import compute_displacement
from pipeline.stages.depth.bubble_network_input import make_network_input
from pipeline.stages.depth.bubble_network_output import BubbleOutputTensors, decode_tensors
from pipeline.stages.metrics.stage_metrics import iou

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.lab.training.task import Example, Split

VERSION = 3  # part of the seeds: incremented when the same number gives another press
MAX_GAP_MM = 8.0  # larger gaps are stored as this: nothing in a frame tells them apart
_N_GEOMETRIES = 12  # bubbles of other shapes and cameras, besides the nominal one
# in training: nominal geometries, training
_NOMINAL_SHARE = 0.6
_CATALOGUE_SHARE = 0.33
_AS_RECORDED_SHARE = 0.6
# objects, and poses and approach as in the data sets
# a membrane bridges a free rim of 8 to 15 mm nearly as if it were a face
_SMALL_SHARE = 0.45
_OUTLINE_SHARE = 0.5


@frozen
class BubblePress:
    """The exact state of a bubble under an object; arrays (rows, cols)."""

    sensor: SensorSpec  # the instance
    indentation_mm: Floats  # rest depth - depth of the membrane
    gap_mm: Floats  # from the membrane to the object behind it along z, 0 to MAX_GAP_MM
    contact: Mask  # pressure > 0
    incidence_cosine: Floats  # of the angle between the camera's ray and the membrane's normal


_presses = SampleCache(BubblePress, max_bytes=1 << 29)


def simulate_bubble_press(split: DataSplit, seed: int, index: int, folder: str = "") -> BubblePress:
    """Press `index` of a seed, the same on every call."""
    in_training = split == "training"
    rng = np.random.default_rng([VERSION, DATA_SPLITS.index(split), seed, index])
    nominal = not in_training or rng.random() < _NOMINAL_SHARE
    geometry = 0 if nominal else int(rng.integers(1, _N_GEOMETRIES + 1))
    sensor = variation.vary_sensor(_make_bubble(geometry), int(rng.integers(1 << 31)), 1.0)

    def make() -> BubblePress:
        _, mesh = sample_object(
            split,
            rng,
            index,
            catalogue_share=_CATALOGUE_SHARE,
            small_share=_SMALL_SHARE,
            outline_share=_OUTLINE_SHARE,
        )
        return _simulate_press(mesh, rng, sensor, as_recorded=not in_training)

    return _presses.get(f"bubble_{split}_{seed}_{index}", folder, make, sensor=sensor)


@derive_once
def _make_bubble(geometry: int) -> SensorSpec:
    """The nominal bubble (0), or one of another size, height and focal length."""
    nominal = load_sensor("soft_bubble")
    assert nominal.bubble is not None
    if not geometry:
        return nominal
    rng = np.random.default_rng([VERSION, geometry])
    width, height, rise, focal = rng.uniform((0.75, 0.75, 0.7, 0.75), (1.05, 1.1, 1.15, 1.3))
    shape: Bubble = replace(
        nominal.bubble,
        half_width_mm=width * nominal.bubble.half_width_mm,
        half_height_mm=height * nominal.bubble.half_height_mm,
        height_mm=rise * nominal.bubble.height_mm,
    )
    surface = membrane.make_dome_membrane(
        80.0 - shape.height_mm, shape.height_mm, shape.half_width_mm, shape.half_height_mm
    )
    camera = replace(
        nominal.camera, fx_px=focal * nominal.camera.fx_px, fy_px=focal * nominal.camera.fy_px
    )
    return replace(
        nominal,
        bubble=shape,
        membrane=surface,
        camera=camera,
        rest_depth_mm=surface.rest_depth_mm(camera),
    )


def _simulate_press(
    mesh: Mesh, rng: np.random.Generator, sensor: SensorSpec, *, as_recorded: bool
) -> BubblePress:
    if as_recorded or rng.random() < _AS_RECORDED_SHARE:
        deeper = BUBBLE_DEEPER_MM
        pose = poses.sample_press_pose(mesh, rng)
    else:
        deeper = rng.uniform(-4.0, BUBBLE_DEEPER_MM + 2.0)
        pose = poses.sample_press_pose(mesh, rng, spread_mm=30.0, angle_deg=180.0, tilt_deg=12.0)
    press = simulate_press(mesh, pose, move_bubble_closer(sensor, deeper), seed=None)
    vertices = rigid.apply(press.sensor_from_object, mesh.vertices_mm)
    surface = render_mesh(vertices, mesh.triangles, sensor.camera)[0]
    depth = sensor.rest_depth_mm - press.indentation_mm
    gap = np.nan_to_num(np.maximum(surface - depth, 0.0), nan=MAX_GAP_MM)
    return BubblePress(
        sensor=sensor,
        indentation_mm=press.indentation_mm,
        contact=press.contact,
        gap_mm=np.minimum(gap, MAX_GAP_MM).astype(np.float32),
        incidence_cosine=bubble.compute_incidence_cosine(sensor.camera, depth).astype(np.float32),
    )


# of examples: little noise shows how a membrane sags between rims
_QUIET_SHARE = 0.15
_QUIET_NOISE = 0.6
# times the described noise; Punyo's stereo camera has the least of those examined
_MAX_NOISE = 2.0
_MIN_NOISE = 0.12


def simulate_noisy_depth_pair(
    press: BubblePress, rng: np.random.Generator, *, plain: bool = False
) -> tuple[Floats, Floats]:
    """(reference, touched) depth (rows, cols) in mm, NaN = no value.

    `plain` adds the described noise alone.

    Instances with more or less noise, a fixed pattern (the membrane's texture), blobs of false
    matches, membranes that do not return to rest, borders and holes without a value.
    """
    sensor = _sample_camera(press.sensor, rng, plain)
    shape = press.indentation_mm.shape
    rest = sensor.rest_depth_mm.astype(np.float64)
    now = rest - press.indentation_mm
    if not plain:
        texture = np.float32(0.0)
        if rng.random() < 0.4:  # a fixed pattern in every frame of an instance, mm
            texture = rng.uniform(0.02, 0.3) * _sample_field(rng, shape, rng.uniform(1.5, 8.0))
        untouched = not press.contact.any()
        if untouched or rng.random() < 0.35:
            now = now - _sample_drift(rng, shape, 1.3 if untouched else 0.25)
        if rng.random() < 0.4:
            now = now - _sample_blobs(rng, shape)
        rest = rest + texture
        now = now + texture
    seeds = rng.integers(0, 1 << 62, 2)
    states = ((rest, bubble.compute_rest_cosine(sensor)), (now, press.incidence_cosine))
    first, second = (
        np.array(bubble.simulate_depth_frame(sensor, depth, int(seed), cosine=cosine))
        for (depth, cosine), seed in zip(states, seeds, strict=True)
    )
    if not plain and rng.random() < 0.25:  # the mean of several reference frames
        first += np.float32(rng.uniform(0.2, 0.8)) * (rest - first).astype(np.float32)
    if not plain and rng.random() < 0.3:
        gaps = _sample_gaps(rng, shape)
        first[gaps] = np.nan
        second[gaps] = np.nan
    return freeze(first), freeze(second)


def _sample_camera(sensor: SensorSpec, rng: np.random.Generator, plain: bool) -> SensorSpec:
    """The instance with a time-of-flight or a stereo camera, of more or less noise than
    described.
    """
    assert sensor.bubble is not None
    camera = _load_depth_camera("soft_bubble" if rng.random() < 0.5 else "soft_bubble_stereo")
    if plain or camera is None:
        return replace(sensor, depth_camera=camera)
    if rng.random() < _QUIET_SHARE:
        factor = rng.uniform(_MIN_NOISE, _QUIET_NOISE)
    else:
        factor = float(np.clip(np.exp(rng.normal(-0.1, 0.5)), _MIN_NOISE, _MAX_NOISE))
    grain = camera.grain_px * rng.uniform(0.6, 1.5)
    noisier = replace(sensor.bubble, depth_noise_mm=factor * sensor.bubble.depth_noise_mm)
    return replace(sensor, bubble=noisier, depth_camera=replace(camera, grain_px=grain))


@derive_once
def _load_depth_camera(name: str) -> DepthCamera | None:
    return load_sensor(name).depth_camera


def _sample_field(rng: np.random.Generator, shape: tuple[int, ...], length_px: float) -> Floats:
    """A smooth random field of mean 0 and standard deviation 1."""
    import cv2

    n = max(2, int(min(shape) / max(length_px, 1.0)))
    coarse = rng.standard_normal((n + 2, n + 2)).astype(np.float32)
    field = np.asarray(cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC), np.float32)
    return (field - field.mean()) / max(float(field.std()), 1e-6)


def _sample_drift(rng: np.random.Generator, shape: tuple[int, ...], max_mm: float) -> Floats:
    """Change of the rest shape in mm: long waves, a lasting bump, more or less air."""
    wave = rng.uniform(0.0, 0.35) * _sample_field(rng, shape, rng.uniform(40.0, 90.0))
    rows, cols = (np.linspace(-1.0, 1.0, n, dtype=np.float32) for n in shape)
    (cy, cx), width = rng.uniform(-0.8, 0.8, 2), rng.uniform(0.2, 0.7)
    distance_sq = ((rows[:, None] - cy) ** 2 + (cols[None, :] - cx) ** 2) / width**2
    bump = rng.uniform(-0.6, 1.0) * np.exp(-0.5 * distance_sq)
    air = rng.uniform(-0.4, 0.4) * (1.0 - 0.7 * rows[:, None] ** 2 - 0.7 * cols[None, :] ** 2)
    return (max_mm * rng.random() * (wave + bump + air)).astype(np.float32)


def _sample_blobs(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """False matches that span some pixels, mm."""
    blobs = np.zeros(shape, np.float32)
    for _ in range(rng.integers(1, 9)):
        row = rng.uniform(0, shape[0])
        col = rng.uniform(0, shape[1])
        width = rng.uniform(0.8, 4.0, 2)
        y = np.arange(shape[0], dtype=np.float32) - row
        x = np.arange(shape[1], dtype=np.float32) - col
        height = rng.uniform(-1.5, 1.5)
        blobs += height * np.exp(
            -0.5 * ((y[:, None] / width[0]) ** 2 + (x[None, :] / width[1]) ** 2)
        )
    return blobs


def _sample_gaps(rng: np.random.Generator, shape: tuple[int, ...]) -> Mask:
    """Pixels (rows, cols) without a value: beyond a ragged border, and in holes."""
    rows, cols = (np.linspace(-1.0, 1.0, n) for n in shape)
    radius = np.hypot(rows[:, None] - rng.uniform(-0.2, 0.2), cols - rng.uniform(-0.2, 0.2))
    ragged = radius + 0.1 * _sample_field(rng, shape, rng.uniform(6.0, 20.0))
    border = ragged > rng.uniform(0.9, 1.6)
    holes = _sample_field(rng, shape, rng.uniform(3.0, 8.0)) > rng.uniform(2.0, 4.0)
    return np.asarray(border | holes, np.bool_)


# the object's surface is trained where it is at most this far behind the membrane
OBSERVED_GAP_MM = 0.5
_UNTOUCHED_SHARE = 0.1
_TIP_MM = 1.5  # decay of the weight behind the object's tip: a stiffer sensor feels the tip alone
# weights in the loss
_MEMBRANE_TERM = 0.5
_UNCERTAINTY_TERM = 0.05
_SMALL_CONTACT_PX = 50.0  # contacts of fewer pixels weigh less


@frozen
class BubbleDepthTask(SimulatedPresses):
    """Settings of the examples and weights of the loss."""

    side: int = setting(
        140,
        "Crop side",
        unit="px",
        low=32,
        high=1024,
        step=2,
        help="of the square cut from a frame",
    )
    mask_weight: float = setting(0.15, "Mask weight", low=0.0, high=100.0)
    touch_weight: float = setting(
        0.0,
        "Touch weight",
        low=0.0,
        high=100.0,
        help="of what a gel would feel of the object's tip",
    )

    def sample(self, rng: np.random.Generator) -> Example:
        """A press with new noise: a crop of the frame, rotated by quarter turns or mirrored."""
        index = int(rng.integers(self.n_presses))
        press = simulate_bubble_press("training", self.press_seed, index, self.folder)
        if rng.random() < _UNTOUCHED_SHARE:
            zero = np.zeros_like(press.indentation_mm)
            press = replace(
                press,
                indentation_mm=zero,
                contact=np.zeros_like(press.contact),
                gap_mm=np.full_like(zero, MAX_GAP_MM),
                incidence_cosine=bubble.compute_rest_cosine(press.sensor).astype(np.float32),
            )
        example = _make_example(press, rng, plain=False)
        rows, cols = press.indentation_mm.shape
        top, left = (int(rng.integers(0, max(n - self.side, 0) + 1)) for n in (rows, cols))
        quarters = int(rng.integers(4))
        mirror = bool(rng.integers(2))

        def crop_and_flip(a: Floats) -> Floats:
            part = np.rot90(
                a[..., top : top + self.side, left : left + self.side], quarters, axes=(-2, -1)
            )
            return np.ascontiguousarray(part[..., ::-1] if mirror else part)

        return {name: crop_and_flip(a) for name, a in example.items()}

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A whole frame of a training object in a new pose, or of an unseen tool."""
        press = simulate_bubble_press(split, VALIDATION_SEED, index, self.folder)
        return _make_example(press, np.random.default_rng([2, index]), plain=True)

    def compute_loss(
        self, network: nn.Module, batch: Mapping[str, Tensor]
    ) -> tuple[Tensor, dict[str, Any]]:
        """Errors of the object's surface, the membrane and both masks, and likelihood of the
        predicted uncertainty.
        """
        import torch
        from torch.nn import functional

        prediction = decode_tensors(network(batch["image"]), batch["smooth"])
        displacement, gap, contact = batch["truth"].unbind(1)
        observed = (gap < OBSERVED_GAP_MM).float()
        weight = observed * (
            1.0 + 3.0 * torch.exp(-torch.clamp(batch["tip_mm"][:, 0], min=0.0) / _TIP_MM)
        )
        error = torch.abs(prediction.object_displacement_mm - (displacement - gap))
        surface = ((error * weight).sum((1, 2)) / (weight.sum((1, 2)) + _SMALL_CONTACT_PX)).mean()
        membrane_error = torch.abs(prediction.displacement_mm - displacement)
        masks = functional.binary_cross_entropy_with_logits(prediction.contact, contact)
        masks = masks + functional.binary_cross_entropy_with_logits(
            prediction.object_in_view, observed
        )
        known = torch.where(observed > 0, error, membrane_error).detach()
        spread = (known * torch.exp(-prediction.log_error) + prediction.log_error).mean()
        touch = _compute_touch_error(prediction, displacement - gap, batch["tip_mm"][:, 0])
        return weigh_terms(
            {
                "surface": (1.0, surface),
                "membrane": (_MEMBRANE_TERM, membrane_error.mean()),
                "masks": (self.mask_weight, masks),
                "spread": (_UNCERTAINTY_TERM, spread),
                "touch": (self.touch_weight, touch),
            }
        )

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Errors of the object's surface where it is observed and of the membrane, and IoU of
        both masks.
        """
        import torch

        rows: list[dict[str, float]] = []
        for example in held_out:
            with torch.inference_mode():
                image, smooth = (torch.tensor(example[k])[None] for k in ("image", "smooth"))
                prediction = decode_tensors(network(image), smooth)
            displacement, gap, contact = example["truth"]
            observed = gap < OBSERVED_GAP_MM
            error = np.abs(prediction.object_displacement_mm[0].numpy() - (displacement - gap))
            tip = observed & (example["tip_mm"][0] < 1.0)
            membrane_error = np.abs(prediction.displacement_mm[0].numpy() - displacement)
            rows.append(
                {
                    "object surface error, mm": error[observed].mean(),
                    "object tip error, mm": error[tip].mean(),
                    "membrane error, mm": membrane_error.mean(),
                    "contact IoU": iou(prediction.contact[0].numpy() > 0, contact > 0),
                    "observed object IoU": iou(prediction.object_in_view[0].numpy() > 0, observed),
                }
            )
        return average_rows(rows)


def _compute_touch_error(
    prediction: BubbleOutputTensors, object_mm: Tensor, behind_tip_mm: Tensor
) -> Tensor:
    """Expected error of the object's depth in a gel at a random level, where contact is stated
    with its probability.
    """
    import torch

    low, high = DEPTH_RANGE_MM
    level = (
        low
        + (high - low) * torch.rand(len(object_mm), 1, 1, device=object_mm.device)
        - behind_tip_mm
    )
    true = torch.clamp(level, min=0.0)
    stated = torch.clamp(level + prediction.object_displacement_mm - object_mm, min=0.0)
    share = torch.sigmoid(prediction.contact)
    error = (share * torch.abs(stated - true) + (1.0 - share) * true).sum((1, 2))
    return (error / ((true > 0).sum((1, 2)) + _SMALL_CONTACT_PX)).mean()


def _make_example(press: BubblePress, rng: np.random.Generator, *, plain: bool) -> Example:
    rest, now = simulate_noisy_depth_pair(press, rng, plain=plain)
    displacement, level, valid, _ = compute_displacement(
        rest, now, press.sensor.limits.indentation_max_mm, []
    )
    network_input = make_network_input(displacement, level, valid, press.sensor.pixel_mm)
    surface = press.sensor.rest_depth_mm.astype(np.float32) - press.indentation_mm + press.gap_mm
    observed = press.gap_mm < OBSERVED_GAP_MM
    behind_tip = surface - (surface[observed].min() if observed.any() else 0.0)
    return {
        "image": network_input.channels,
        "smooth": network_input.smooth_displacement_mm[None],
        "truth": np.stack([press.indentation_mm, press.gap_mm, press.contact.astype(np.float32)]),
        "tip_mm": behind_tip.astype(np.float32)[None],
    }
