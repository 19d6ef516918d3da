"""Pairs of difference tiles as training examples of touch to touch: images that are not metric.

Training sets publish pairs as squares, each stretched in contrast by itself, rotated, and with jittered colours, so
that neither depth nor a camera is known. The orientation follows from the gel's colours (`imprints.tiles`);
how large a gel's tile lies in a bubble's follows from a fit to the pairs that are trained on (`imprints.fitting`). A
network is trained toward likeness: the partial correlation of its one-step imprint with the recorded one, the mean
imprint regressed out of both, since a mean alone looks like every touch. Colours are mixed, as those of tiles are.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Image, freeze
from pipeline.base.errors import SettingProblem
from pipeline.geometry import rigid
from pipeline.imprints.agreement import compute_correlation, compute_mean_imprint
from pipeline.imprints.fitting import fit_pairs
from pipeline.imprints.image_rotation import orient_image
from pipeline.imprints.tiles import SOURCE_TILES, TARGET_TILES, ImprintPairs, is_tile_folder, load_tile_pairs
from pipeline.imprints.transfer import ImprintPair, TransferModel
from pipeline.recordings import image_files
from pipeline.sensors import alignment
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.touch.depth_condition import make_working_sensor
from pipeline.stages.touch.image_condition import build_image_condition
from pipeline.training.conditioned_touch import ConditionedTouch, jitter_touch
from pipeline.training.distributed import unwrap_network
from pipeline.training.hold_out import assign_roles
from pipeline.training.recorded_pairs import PairFolder
from pipeline.training.touch_pairs import BUBBLE
from pipeline.training.touch_residual import make_residual_example
from pipeline.training.touch_to_touch import TouchToTouchTask
from pipeline.values.frames import Grasp

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.task import Example, Split

_NAME = re.compile(r"^(?P<split>.+?)_(?P<number>\d+)_(?P<tool>.+)$")  # training_07_pattern_01
_STRONG_GREY, _DEEP_MM, _DEEP_GEL_MM = 60.0, 6.0, 0.6  # what the strongest change of a tile stands for
_LOW, _HIGH, _TOUCHED = 2.0, 99.5, 0.35  # percentiles of an imprint's range; share of it that is in contact
_COLOUR_MIXING = 0.25  # largest share of one colour added to another
_SCALE_TERM, _CONTACT_TERM, _HUBER = 0.1, 0.1, 0.25  # weights in the loss; units of the residual
_TINY = 1e-6
_VIEWS = ((0, 0, 0), (3, 0, 3), (-3, 0, -3), (0, 3, -3), (0, -3, 3))  # px, px, deg: their mean is the expected imprint


@dataclass(frozen=True, slots=True, kw_only=True)
class TileSet:
    """Tiles on the target's grid: those that are trained on, and all others by split."""

    training: tuple[ConditionedTouch, ...]
    held_out: Mapping[str, tuple[ConditionedTouch, ...]]
    mean_imprint: Floats  # (rows, cols) of those that are trained on
    notes: tuple[str, ...]


@lru_cache(maxsize=2)
def open_tiles(folder: PairFolder, source_name: str, target_name: str) -> TileSet:
    """The tiles of a folder by role; raises FileProblem where nothing is paired, SettingProblem as `assign_roles`."""
    source, target = load_sensor(source_name), load_sensor(target_name)
    gel = target if source.sensor_kind.is_depth else source
    bubble = source if source.sensor_kind.is_depth else target
    loaded, roles, transfer = _fit_tiles(folder, gel.name)
    path, n_used = Path(folder.path), roles.count("training")
    note = f"{n_used} pairs of tiles are trained on, the other {len(roles) - n_used} validate"
    by_role: dict[str, list[ConditionedTouch]] = {}
    for pair, orientation, role in zip(loaded.pairs, loaded.orientations, roles, strict=True):
        tile = orient_image(image_files.read_rgb(path / SOURCE_TILES.replace("*", pair.name)), orientation)
        by_role.setdefault(role, []).append(_place_tiles(tile, pair, gel, bubble, transfer, target))
    training = tuple(by_role.pop("training"))
    mean = compute_mean_imprint([touch.indentation_mm for touch in training]).astype(np.float32)
    return TileSet(
        training=training, held_out={role: tuple(touches) for role, touches in by_role.items()},
        mean_imprint=freeze(mean), notes=(note, *loaded.notes),
    )  # fmt: skip


@lru_cache(maxsize=2)
def _fit_tiles(folder: PairFolder, gel_name: str) -> tuple[ImprintPairs, list[str], TransferModel]:
    """(pairs, role of each, map from the gel's tile to the bubble's by those that are trained on)."""
    loaded = load_tile_pairs(Path(folder.path), load_sensor(gel_name), SOURCE_TILES, TARGET_TILES)
    grasps = [_parse_grasp(pair.name, number) for number, pair in enumerate(loaded.pairs)]
    hold_out = assign_roles(grasps, folder.hold_out, folder.share)
    roles = ["unseen_grasps" if role == "left_out" else role for role in hold_out.roles]
    fit = fit_pairs([p for p, role in zip(loaded.pairs, roles, strict=True) if role == "training"])
    return loaded, roles, fit.transfer


def _parse_grasp(name: str, number: int) -> Grasp:
    """Split, number and tool of a tile's name; its own tool where the name has another form."""
    match = _NAME.match(name)
    return Grasp(tool=name, number=number) if match is None else Grasp(
        tool=match["tool"], number=int(match["number"]), split=match["split"]
    )  # fmt: skip


def _place_tiles(
    tile: Image, pair: ImprintPair, gel: SensorSpec, bubble: SensorSpec, how: TransferModel, target: SensorSpec
) -> ConditionedTouch:
    """A pair as simulated ones are conditioned: half a turn from each other, pixels of the target's own size."""
    both = alignment.resolve_alignment(gel, bubble)
    rows, cols = tile.shape[:2]
    gel_camera = replace(
        gel.camera, rows=rows, cols=cols, cx_px=(cols - 1) / 2, cy_px=(rows - 1) / 2,
        fx_px=gel.camera.fx_px * cols / gel.camera.cols, fy_px=gel.camera.fy_px * rows / gel.camera.rows,
    )  # fmt: skip
    rest_mm = float(np.median(gel.rest_depth_mm))
    x, y, z = rigid.apply(both.target_from_source, np.array([[0.0, 0.0, rest_mm]]))[0]
    per_px = rest_mm * bubble.camera.fx_px / z / how.scale  # pixels of the bubble's tile over those of the gel's
    tall, wide = round(per_px * rows / gel_camera.fy_px), round(per_px * cols / gel_camera.fx_px)
    bubble_camera = replace(
        bubble.camera, rows=tall, cols=wide,
        cx_px=(0.5 - how.right) * wide - 0.5 - bubble.camera.fx_px * x / z,
        cy_px=(0.5 - how.down) * tall - 0.5 - bubble.camera.fy_px * y / z,
    )  # fmt: skip
    change = _compute_change(tile)
    imprint_mm = _DEEP_MM * _resize(orient_image(_stretch(pair.imprint), 2), (tall, wide))
    if target.sensor_kind.is_depth:
        condition = build_image_condition(change, gel_camera, gel, bubble.with_camera(bubble_camera), both)
        return ConditionedTouch(
            condition=condition, indentation_mm=imprint_mm, contact=imprint_mm > _TOUCHED * _DEEP_MM
        )
    grid, back = make_working_sensor(gel), alignment.resolve_alignment(bubble, gel)
    ridges = _resize(pair.contact, grid.camera.shape)
    return ConditionedTouch(
        condition=build_image_condition(imprint_mm, bubble_camera, bubble, grid, back),
        indentation_mm=_DEEP_GEL_MM * ridges, contact=ridges > _TOUCHED,
    )  # fmt: skip


def _compute_change(tile: Image) -> Floats:
    """Difference of a tile from its median colour, of the usual strength, grey levels."""
    change = tile.astype(np.float32) - np.median(tile.reshape(-1, 3), axis=0).astype(np.float32)
    return change * np.float32(_STRONG_GREY / max(float(np.percentile(np.abs(change), _HIGH)), 1.0))


def _stretch(imprint: Floats) -> Floats:
    """The imprint as a share of its range, about 0 to 1; linear, so that likeness is that of the tiles."""
    low, high = np.percentile(imprint, (_LOW, _HIGH))
    return ((imprint - low) / max(float(high - low), _TINY)).astype(np.float32)


def _resize(field: Floats, shape: tuple[int, int]) -> Floats:
    import cv2

    how = cv2.INTER_AREA if shape[0] < field.shape[0] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(np.ascontiguousarray(field), shape[::-1], interpolation=how), np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class TileTask:
    """Touch to touch on tiles."""

    task: TouchToTouchTask
    sensors: tuple[str, str]  # of source and target
    folder: PairFolder

    def sample(self, rng: np.random.Generator) -> Example:
        """A tile pair, moved, rotated and brightened a little, its colours mixed."""
        touch = jitter_touch(self._tiles.training[int(rng.integers(len(self._tiles.training)))], rng)
        return self._make_example(_mix_colours(touch, rng) if self.task.target == BUBBLE else touch)

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A held-out pair."""
        return self._make_example(self._tiles.held_out[split][index])

    def count_validation_examples(self, split: Split) -> int:
        """Number of held-out pairs of a split."""
        return len(self._tiles.held_out.get(split, ()))

    def collect_notes(self) -> tuple[str, ...]:
        """What was held out and estimated of the tiles."""
        return self._tiles.notes

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """1 - partial correlation of one step with the recorded imprint, and a little of scale and contact."""
        import torch
        from torch.nn import functional

        true, condition = batch["residual"], batch["condition"]
        sigma = torch.full((len(true),), float(unwrap_network(network).sigma_max), device=true.device)
        predicted = network(torch.zeros_like(true), sigma, condition)
        common = torch.from_numpy(np.array(self._tiles.mean_imprint)).to(true.device)
        common = common - common.mean()

        def regress_out_mean(field: Tensor) -> Tensor:
            centred = field - field.mean((1, 2), keepdim=True)
            share = (centred * common).sum((1, 2), keepdim=True) / common.square().sum().clamp(min=_TINY)
            return centred - share * common

        one, other = regress_out_mean(predicted[:, 0]), regress_out_mean(true[:, 0])
        sizes = one.square().sum((1, 2)) * other.square().sum((1, 2))
        unlike = (1.0 - (one * other).sum((1, 2)) / (sizes + _TINY).sqrt()).mean()
        scale = functional.huber_loss(predicted[:, 0], true[:, 0], delta=_HUBER) / _HUBER
        contact = functional.mse_loss(predicted[:, 1], true[:, 1])
        terms = {"unlike": unlike.detach(), "scale": scale.detach(), "contact": contact.detach()}
        return unlike + _SCALE_TERM * scale + _CONTACT_TERM * contact, terms

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Partial correlation with recorded imprints, the mean imprint regressed out (which has 0)."""
        mean = self._tiles.mean_imprint.astype(np.float64)
        single, several, plain = [], [], []
        for example in held_out:
            views = [_predict(network, example["condition"], view) for view in _VIEWS]
            true = example["residual"][0]
            single.append(compute_correlation(views[0], true, mean))
            several.append(compute_correlation(np.mean(views, axis=0), true, mean))
            plain.append(compute_correlation(mean, true))
        return {
            "partial correlation": float(np.mean(several)),
            "partial correlation of one view": float(np.mean(single)),
            "correlation of the mean imprint": float(np.mean(plain)),
        }

    @property
    def _tiles(self) -> TileSet:
        return open_tiles(self.folder, *self.sensors)

    def _make_example(self, touch: ConditionedTouch) -> Example:
        nothing = np.zeros(touch.contact.shape, np.bool_)
        return make_residual_example(touch.condition, touch.indentation_mm, touch.contact, nothing, self.task.kind)


def holds_tiles(folder: PairFolder) -> bool:
    """Whether the pairs are tiles."""
    return bool(folder.path) and is_tile_folder(Path(folder.path))


def use_tiles(task: Any, folder: PairFolder) -> TileTask:
    """`task` on the tiles of a folder; raises SettingProblem for a task that cannot."""
    if not isinstance(task, TouchToTouchTask):
        raise SettingProblem("tiles of pairs are not metric and train t2t alone; give recordings of both sensors")
    return TileTask(task=task, sensors=task.pair_sensors, folder=folder)


def _mix_colours(touch: ConditionedTouch, rng: np.random.Generator) -> ConditionedTouch:
    """The pair with the colours of a gel's image mixed into each other."""
    n = len(touch.condition) // 3 * 3
    mixing = (np.eye(3) + rng.uniform(-_COLOUR_MIXING, _COLOUR_MIXING, (3, 3))).astype(np.float32)
    mixed = (mixing @ touch.condition[:n].reshape(3, -1)).reshape(touch.condition[:n].shape)
    return replace(touch, condition=freeze(np.concatenate([mixed, touch.condition[n:]])))


def _predict(network: nn.Module, condition: Floats, view: tuple[int, int, int]) -> Doubles:
    """One step's imprint (rows, cols) of a condition that is moved and rotated, moved back."""
    import cv2
    import torch

    rows, cols = condition.shape[-2:]
    matrix = cv2.getRotationMatrix2D(((cols - 1) / 2, (rows - 1) / 2), view[2], 1.0)
    matrix[:, 2] += view[:2]

    def warp(field: Floats, how: Any) -> Floats:
        whole = np.ascontiguousarray(field, np.float32)
        return np.asarray(cv2.warpAffine(whole, how, (cols, rows), borderMode=cv2.BORDER_REPLICATE), np.float32)

    moved = torch.from_numpy(np.stack([warp(channel, matrix) for channel in condition]))[None]
    sigma = torch.full((1,), float(unwrap_network(network).sigma_max))
    with torch.inference_mode():
        made = network(torch.zeros(1, 2, rows, cols), sigma, moved)[0, 0].float().numpy()
    return warp(made, cv2.invertAffineTransform(matrix)).astype(np.float64)
