"""What a touch tells a registration: the surface that was felt, and the space in which nothing was."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Indices, Mask
from pipeline.geometry import rigid
from pipeline.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.geometry.normals import compute_area_vectors
from pipeline.registration.model import ObjectModel
from pipeline.values.results import DepthErrorModel, DepthMap

COMPUTED = DepthErrorModel(
    rms_mm=0.0, correlation_mm=0.5
)  # a membrane relaxes over about this length: the gel's pixels do
MOST_TURNED_AWAY = -0.2  # cosine to the felt normal; the wall of a notch is steep, the far side of a plate is at -1

# A touch translated from a thin gel says nothing of what lies deeper than that gel reached, which is where the contact
# ends: a bubble would have wrapped the object's shoulders, the gel never met them.
_RIM_PERCENT, _RIM_MM = 95.0, 0.25

# What a network generated is known to the error that it tells: an object may stick out of it by as much, three times
# over (24 touches of unseen tools: shifts are 0.71 mm off so, 0.99 by two times, 1.27 by none).
_TOLD = 3.0

_MIN_PART = 10  # points; fewer are no surface


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactScene:
    """Felt points in the sensor frame, and the whole membrane that no object may stick out of."""

    points_mm: Doubles  # (n, 3)
    normals: Doubles  # (n, 3) out of the object, toward the camera
    pixel: Indices  # (n,) flat pixel of the touch
    area_mm2: float  # of the contact, along the surface
    membrane_mm: Floats  # (rows, cols) z that no object comes nearer than unfelt; NaN where the source could not see
    off_contact_mm: Floats  # (rows, cols) distance to the nearest contact; 0 where the source could not see
    camera: Camera
    noise_mm: float  # of single pixels: what a smooth surface does not have
    error: DepthErrorModel  # beside that noise

    @property
    def pixel_mm(self) -> float:
        """Width of a pixel where the contact is."""
        return float(np.median(self.points_mm[:, 2])) / self.camera.fx_px


def extract_scene(felt: DepthMap, max_points: int, seed: int) -> ContactScene:
    """At most `max_points` contact points of a felt touch with their normals; a seeded choice where there are more."""
    known = np.ones(felt.contact.shape, np.bool_) if felt.in_view is None else felt.in_view
    usable = felt.contact & (felt.depth_mm > MIN_DEPTH_MM) & np.isfinite(felt.depth_mm)
    top, left, rows, cols = _box(usable)
    part = np.s_[top : top + rows, left : left + cols]
    seen = felt.camera.crop(top, left, rows, cols)
    surface = seen.back_project(np.where(usable[part], felt.depth_mm[part], np.nan))
    # Over contact pixels only: the membrane beside a contact is not the object.
    across = compute_area_vectors(surface).reshape(-1, 3)
    area = np.linalg.norm(across, axis=1)
    chosen = np.flatnonzero(np.isfinite(area) & (area > 0))
    area_mm2 = float(area[chosen].sum())
    if chosen.size > max_points:
        chosen = np.sort(np.random.default_rng(seed).choice(chosen, max_points, replace=False))
    row, col = np.divmod(chosen, max(cols, 1))
    import cv2

    typical_mm = float(np.median(felt.depth_mm[usable])) / felt.camera.fx_px if usable.any() else 0.0
    off_px = np.asarray(cv2.distanceTransform((~usable).astype(np.uint8), cv2.DIST_L2, 5), np.float32)
    farthest_mm = float(np.percentile(felt.depth_mm[usable], _RIM_PERCENT)) + _RIM_MM if usable.any() else 0.0
    return ContactScene(
        points_mm=surface.reshape(-1, 3)[chosen],
        normals=across[chosen] / area[chosen, None],
        pixel=((row + top) * felt.camera.cols + col + left).astype(np.int32),
        area_mm2=area_mm2,
        membrane_mm=np.where(
            known, np.minimum(felt.depth_mm, np.float32(farthest_mm)) - _told_mm(felt), np.float32(np.nan)
        ),
        off_contact_mm=np.where(known, off_px * np.float32(typical_mm), np.float32(0.0)),
        camera=felt.camera,
        noise_mm=_noise_mm(surface[..., 2]),
        error=felt.error or COMPUTED,
    )


def _told_mm(felt: DepthMap) -> Floats:
    """How far (rows, cols) an object may stick out of a generated touch that tells its own error; 0 of all others."""
    if felt.expected_error_mm is None or not felt.is_generated:
        return np.zeros(felt.contact.shape, np.float32)
    return np.float32(_TOLD) * np.nan_to_num(felt.expected_error_mm)


def _noise_mm(depth_mm: Doubles) -> float:
    """Standard deviation of what single pixels have beside a surface that is straight over three of them."""
    middle = depth_mm[1:-1, 1:-1]
    bent = 4.0 * middle - depth_mm[:-2, 1:-1] - depth_mm[2:, 1:-1] - depth_mm[1:-1, :-2] - depth_mm[1:-1, 2:]
    bent = np.abs(bent[np.isfinite(bent)])
    return 1.4826 * float(np.median(bent)) / math.sqrt(20.0) if bent.size else 0.0


def _box(mask: Mask) -> tuple[int, int, int, int]:
    """(top, left, rows, cols) around what is marked; at least one pixel."""
    rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not rows.size:
        return 0, 0, 1, 1
    return int(rows[0]), int(cols[0]), int(rows[-1] - rows[0]) + 1, int(cols[-1] - cols[0]) + 1


def select_in_reach(
    scene: ContactScene, model: ObjectModel, sensor_from_object: Doubles, reach_mm: float
) -> ObjectModel:
    """What of a placed object can have been felt: near the scene and not its far side; all, where nothing is."""
    placed, toward = rigid.apply(sensor_from_object, model.points_mm), scene.normals.mean(axis=0)
    near = model.normals @ (toward @ sensor_from_object[:3, :3]) > MOST_TURNED_AWAY
    low, high = scene.points_mm.min(axis=0) - reach_mm, scene.points_mm.max(axis=0) + reach_mm
    for along, least, most in zip(placed.T, low, high, strict=True):
        near &= (along >= least) & (along <= most)
    return model.select(near) if near.sum() >= _MIN_PART else model
