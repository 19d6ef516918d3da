"""What the denoiser of touch to touch is shown: how the source's reading changed, drawn where the target would see it.

Source and target look at one plane, the gel's surface at rest: that is where the object is when both feel it. A gel's
difference picture is drawn finer than the target's pixels and folded into channels, so that edges which a bubble's
coarse pixels would average away are still told.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, Floats, Mask, freeze
from pipeline.base.memo import Memo
from pipeline.engine.digests import compute_cached_digest
from pipeline.geometry import rigid
from pipeline.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.networks.square_images import normalise
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec

UPSAMPLING = {"gel": 2, "bubble": 1}  # of a source of that kind, than the target's working pixels
CHANNELS = {"gel": 13, "bubble": 3}
_GREY, _MM, _RELIEF_MM = 48.0, 6.0, 1.0  # units of the two kinds of readings, and of a bubble's relief
_SMOOTHED_PX, _TOP = 1.2, 99.5  # of a bubble whose relief is told; per cent of the pixels below its top
_SOURCE_PX_MM = 0.085  # a gel's picture is averaged to pixels of about this before it is drawn


def build_image_condition(
    image_change: NDArray[Any], source_camera: Camera, source: SensorSpec, target: SensorSpec, alignment: Alignment
) -> Floats:
    """(channels, rows, cols) on the grid of `target`, which is the working one.

    `change` is the reading less the untouched one of a camera `eye`: (rows, cols, 3) in grey levels of a gel, (rows,
    cols) of a bubble in mm toward the camera; NaN where there is no reading counts as no change.
    """
    finer = UPSAMPLING[source.kind]
    places = _places(source, source_camera, target, alignment, finer)
    field = np.nan_to_num(np.asarray(image_change, np.float32))
    drawn = _drawn(field, places) / np.float32(_GREY if source.kind == "gel" else _MM)
    channels = [_folded(np.ascontiguousarray(c), finer) for c in np.moveaxis(np.atleast_3d(drawn), -1, 0)]
    known = places.inside[::finer, ::finer].astype(np.float32)
    if source.kind == "bubble":
        channels.append(_relief(field, places)[None])
    return freeze(np.concatenate([*channels, known[None]]).astype(np.float32))


def reproject_square(square_change: Floats, source: SensorSpec, target: SensorSpec, alignment: Alignment) -> Floats:
    """(channels, side, side) of spread 1: a square of the source's change, drawn as a square of the target's.

    Both as `squares.square` makes them. A gel's where the target sees it, 0 beyond; of a bubble the relief that a gel
    feels, see `_relief`.
    """
    side = square_change.shape[-1]
    eye, onto = source.camera.resize(side, side), target.with_camera(target.camera.resize(side, side))
    places = _places(source, eye, onto, alignment, 1)
    if source.kind == "bubble":
        return freeze(_relief(square_change[0], places)[None].astype(np.float32))
    drawn = _drawn(np.ascontiguousarray(normalise(square_change, "gel").transpose(1, 2, 0)), places)
    return freeze(np.ascontiguousarray(drawn.transpose(2, 0, 1)))


@dataclass(frozen=True, slots=True)
class _Places:
    """Where every fine pixel of the target lies in the source's picture, which is first averaged to a size."""

    x: Floats
    y: Floats
    inside: Mask
    size: tuple[int, int] | None  # (cols, rows) px; None = as it is


_known_places: Memo[tuple[str, ...], _Places] = Memo(4)  # of a recording one: what a frame costs is its pixels


def _relief(change: Floats, places: _Places) -> Floats:
    """How far a smoothed bubble stays behind its top within the target's view: what a gel feels is that top."""
    import cv2

    smooth = np.asarray(cv2.GaussianBlur(change, (0, 0), _SMOOTHED_PX), np.float32)
    drawn, inside = _drawn(smooth, places), places.inside
    top = np.float32(np.percentile(drawn[inside], _TOP)) if inside.any() else np.float32(0.0)
    return np.where(inside, np.clip((drawn - top) / np.float32(_RELIEF_MM), -3.0, 1.0), np.float32(-3.0))


def _drawn(field: Floats, places: _Places) -> Floats:
    import cv2

    if places.size is not None:
        field = np.asarray(cv2.resize(field, places.size, interpolation=cv2.INTER_AREA), np.float32)
    found = cv2.remap(field, places.x, places.y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    shown = places.inside if found.ndim == 2 else places.inside[..., None]
    return np.where(shown, np.asarray(found, np.float32), np.float32(0.0))


def _places(source: SensorSpec, source_camera: Camera, target: SensorSpec, alignment: Alignment, finer: int) -> _Places:
    key = *map(compute_cached_digest, (source, source_camera, target, alignment.target_from_source)), str(finer)
    return _known_places.get_or_make(key, lambda: _found_places(source, source_camera, target, alignment, finer))


def _found_places(
    source: SensorSpec, source_camera: Camera, target: SensorSpec, alignment: Alignment, finer: int
) -> _Places:
    x, y, inside = _in_source(source, source_camera, target, alignment, finer)
    scale = min(1.0, source.with_camera(source_camera).pixel_mm / _SOURCE_PX_MM) if source.kind == "gel" else 1.0
    size = (
        None if scale == 1.0 else (max(8, round(source_camera.cols * scale)), max(8, round(source_camera.rows * scale)))
    )
    sx, sy = (1.0, 1.0) if size is None else (size[0] / source_camera.cols, size[1] / source_camera.rows)
    at_x, at_y = ((x + 0.5) * sx - 0.5).astype(np.float32), ((y + 0.5) * sy - 0.5).astype(np.float32)
    return _Places(freeze(at_x), freeze(at_y), freeze(inside), size)


def _in_source(
    source: SensorSpec, source_camera: Camera, target: SensorSpec, alignment: Alignment, finer: int
) -> tuple[Doubles, Doubles, Mask]:
    """(x, y) in px of the source's image for every fine pixel of the target, and where that lies inside the image."""
    camera = target.camera.scale(float(finer))
    from_target = rigid.invert(rigid.validate_rigid(alignment.target_from_source, "the alignment T_S->T"))
    if target.kind == "gel":
        rest = float(np.median(target.rest_depth_mm))
        points = rigid.apply(from_target, camera.back_project(np.full(camera.shape, rest)).reshape(-1, 3))
    else:
        origin = from_target[:3, 3]
        ways = camera.back_project(np.ones(camera.shape)).reshape(-1, 3) @ from_target[:3, :3].T
        rest = float(np.median(source.rest_depth_mm))
        with np.errstate(divide="ignore", invalid="ignore"):
            points = origin + ways * ((rest - origin[2]) / ways[:, 2])[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        x = source_camera.fx_px * points[:, 0] / points[:, 2] + source_camera.cx_px
        y = source_camera.fy_px * points[:, 1] / points[:, 2] + source_camera.cy_px
        inside = (
            (points[:, 2] > MIN_DEPTH_MM)
            & (x >= -0.5)
            & (x < source_camera.cols - 0.5)
            & (y >= -0.5)
            & (y < source_camera.rows - 0.5)
        )
    return (
        np.where(inside, x, 0.0).reshape(camera.shape),
        np.where(inside, y, 0.0).reshape(camera.shape),
        inside.reshape(camera.shape),
    )


def _folded(fine: Floats, finer: int) -> Floats:
    """(finer^2, rows, cols): the fine pixels of each pixel as channels."""
    rows, cols = (n // finer for n in fine.shape)
    parts = fine[: rows * finer, : cols * finer].reshape(rows, finer, cols, finer)
    return parts.transpose(1, 3, 0, 2).reshape(finer * finer, rows, cols)
