"""Extract what a touch gives a registration: the contact surface, and the space that is free."""

import math
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Indices, Mask
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.core.geometry.normals import compute_area_vectors
from pipeline.core.values.results import DepthErrorModel, DepthMap
from pipeline.stages.pose.registration.model import ObjectModel

# correlation length: a membrane relaxes over about this
COMPUTED = DepthErrorModel(rms_mm=0.0, correlation_mm=0.5)
# cosine to the contact normal; a notch's side wall is steep, the far side of a plate is at -1
MOST_TURNED_AWAY = -0.2

# A touch transferred from a thin gel has no information deeper than that gel reached, where the
# contact ends: a bubble would have wrapped the object's shoulders, the gel never touched them.
_RIM_PERCENT = 95.0
_RIM_MM = 0.25

# A generated touch is known to its predicted error: an object may penetrate it by three times that
# (24 touches of unseen tools: translation error 0.71 mm so, 0.99 by two times, 1.27 by none).
_PREDICTED_STDS = 3.0

_MIN_PART = 10  # fewer points are no surface


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactScene:
    """Contact points in the sensor frame, and the membrane that no object may penetrate."""

    points_mm: Doubles  # (n, 3)
    normals: Doubles  # (n, 3) out of the object, toward the camera
    pixel: Indices  # (n,) flat pixel of the touch
    area_mm2: float  # of the contact, along the surface
    # (rows, cols) z that bounds objects without contact; NaN outside the source's view
    membrane_mm: Floats
    # (rows, cols) distance to the nearest contact; 0 outside the source's view
    off_contact_mm: Floats
    camera: Camera
    noise_mm: float  # of single pixels
    error: DepthErrorModel  # correlated error, in addition

    @property
    def pixel_mm(self) -> float:
        """Width of a pixel where the contact is."""
        return float(np.median(self.points_mm[:, 2])) / self.camera.fx_px


def extract_scene(touch: DepthMap, max_points: int, seed: int) -> ContactScene:
    """Extract at most `max_points` contact points with normals.

    A seeded choice where there are more.
    """
    known = np.ones(touch.contact.shape, np.bool_) if touch.in_view is None else touch.in_view
    usable = touch.contact & (touch.depth_mm > MIN_DEPTH_MM) & np.isfinite(touch.depth_mm)
    top, left, rows, cols = _box(usable)
    part = np.s_[top : top + rows, left : left + cols]
    seen = touch.camera.crop(top, left, rows, cols)
    surface = seen.back_project(np.where(usable[part], touch.depth_mm[part], np.nan))
    # Contact pixels only: the membrane around a contact is not the object.
    across = compute_area_vectors(surface).reshape(-1, 3)
    area = np.linalg.norm(across, axis=1)
    chosen = np.flatnonzero(np.isfinite(area) & (area > 0))
    area_mm2 = float(area[chosen].sum())
    if chosen.size > max_points:
        chosen = np.sort(np.random.default_rng(seed).choice(chosen, max_points, replace=False))
    row, col = np.divmod(chosen, max(cols, 1))
    import cv2

    typical_mm = (
        float(np.median(touch.depth_mm[usable])) / touch.camera.fx_px if usable.any() else 0.0
    )
    off_px = np.asarray(
        cv2.distanceTransform((~usable).astype(np.uint8), cv2.DIST_L2, 5), np.float32
    )
    farthest_mm = (
        float(np.percentile(touch.depth_mm[usable], _RIM_PERCENT)) + _RIM_MM
        if usable.any()
        else 0.0
    )
    return ContactScene(
        points_mm=surface.reshape(-1, 3)[chosen],
        normals=across[chosen] / area[chosen, None],
        pixel=((row + top) * touch.camera.cols + col + left).astype(np.int32),
        area_mm2=area_mm2,
        membrane_mm=np.where(
            known,
            np.minimum(touch.depth_mm, np.float32(farthest_mm)) - _allow_penetration_mm(touch),
            np.float32(np.nan),
        ),
        off_contact_mm=np.where(known, off_px * np.float32(typical_mm), np.float32(0.0)),
        camera=touch.camera,
        noise_mm=_noise_mm(surface[..., 2]),
        error=touch.error or COMPUTED,
    )


def _allow_penetration_mm(touch: DepthMap) -> Floats:
    """Return how far (rows, cols) an object may penetrate a generated touch, from its predicted
    error; else 0.
    """
    if touch.expected_error_mm is None or not touch.is_generated:
        return np.zeros(touch.contact.shape, np.float32)
    return np.float32(_PREDICTED_STDS) * np.nan_to_num(touch.expected_error_mm)


def _noise_mm(depth_mm: Doubles) -> float:
    """Return the pixel noise (mm): deviation from a surface that is straight over three pixels."""
    middle = depth_mm[1:-1, 1:-1]
    bent = (
        4.0 * middle
        - depth_mm[:-2, 1:-1]
        - depth_mm[2:, 1:-1]
        - depth_mm[1:-1, :-2]
        - depth_mm[1:-1, 2:]
    )
    bent = np.abs(bent[np.isfinite(bent)])
    return 1.4826 * float(np.median(bent)) / math.sqrt(20.0) if bent.size else 0.0


def _box(mask: Mask) -> tuple[int, int, int, int]:
    """Return (top, left, rows, cols) of the mask's bounding box; at least one pixel."""
    rows = np.flatnonzero(mask.any(axis=1))
    cols = np.flatnonzero(mask.any(axis=0))
    if not rows.size:
        return 0, 0, 1, 1
    return int(rows[0]), int(cols[0]), int(rows[-1] - rows[0]) + 1, int(cols[-1] - cols[0]) + 1


def select_in_reach(
    scene: ContactScene, model: ObjectModel, sensor_from_object: Doubles, reach_mm: float
) -> ObjectModel:
    """Select the part of a placed object that can touch: near the scene and facing it.

    All if there is none.
    """
    placed = rigid.apply(sensor_from_object, model.points_mm)
    toward = scene.normals.mean(axis=0)
    near = model.normals @ (toward @ sensor_from_object[:3, :3]) > MOST_TURNED_AWAY
    low = scene.points_mm.min(axis=0) - reach_mm
    high = scene.points_mm.max(axis=0) + reach_mm
    for along, least, most in zip(placed.T, low, high, strict=True):
        near &= (along >= least) & (along <= most)
    return model.select(near) if near.sum() >= _MIN_PART else model
