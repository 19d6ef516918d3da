"""Prepare the target's side of a touch once: while a handle is dragged only the source's side is
computed.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import Floats, Mask, freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.geometry.camera import Camera
from pipeline.core.values.results import DepthMap
from pipeline.sensors.spec import SensorSpec

PREVIEW_FACTOR = 4  # stride of pixels while a handle is dragged
_MIN_ROWS = 64  # smallest preview; a coarser image is fast at full size


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetObservation:
    """The target's measurement of a touch, on the grid that the source's side is rendered into."""

    spec: SensorSpec  # the target with the camera of this grid
    factor: int  # pixels of the target per pixel here, along each side
    contact: Mask  # (rows, cols)
    depth_mm: Floats  # (rows, cols) target frame; NaN outside the contact
    edge: Mask  # (rows, cols) outermost pixels of the contact
    edge_distance_px: (
        # (rows, cols) distance to the nearest of them, in pixels of this grid; 0 everywhere if none
        Floats
    )


def observe_target(target: DepthMap, spec: SensorSpec, *, factor: int = 1) -> TargetObservation:
    """Reduce the target's depth map of a touch for `score`.

    `factor` 1 is full size, `PREVIEW_FACTOR` for dragging.

    The grid is that of the depth map's own camera. A pixel of a smaller grid is in contact where
    half of its area is. Raises SettingProblem for a factor below 1.
    """
    if factor < 1:
        raise SettingProblem(f"a preview takes every n-th pixel, with n at least 1, got {factor}")
    rendered = spec.with_camera(target.camera)
    if factor > 1:
        rendered = rendered.with_camera(rendered.camera.scale(1.0 / factor))
    contact, depth_mm = _resample(target, rendered.camera)
    edge = find_edge(contact)
    return TargetObservation(
        spec=rendered,
        factor=factor,
        contact=freeze(contact),
        depth_mm=freeze(depth_mm),
        edge=freeze(edge),
        edge_distance_px=freeze(compute_distance_px(edge)),
    )


def choose_preview_factor(spec: SensorSpec) -> int:
    """Return the factor for dragging: `PREVIEW_FACTOR`, less where the image would get too
    small.
    """
    return max(1, min(PREVIEW_FACTOR, min(spec.camera.shape) // _MIN_ROWS))


def find_edge(mask: Mask) -> Mask:
    """Return the pixels of a mask with a neighbour outside it.

    The border of the image is no edge.
    """
    import cv2

    return mask & (cv2.erode(mask.view(np.uint8), np.ones((3, 3), np.uint8)) == 0)


def compute_distance_px(edge: Mask) -> Floats:
    """Return each pixel's distance (rows, cols) to the nearest of `edge`.

    0 everywhere where there is none.
    """
    import cv2

    if not edge.any():
        return np.zeros(edge.shape, np.float32)
    return np.asarray(
        cv2.distanceTransform((~edge).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5), np.float32
    )


def _resample(target: DepthMap, camera: Camera) -> tuple[Mask, Floats]:
    """Return contact and depth on the grid of `camera`: area shares, and means over the contact."""
    import cv2

    usable = target.contact & np.isfinite(target.depth_mm)
    depth_mm = np.where(usable, target.depth_mm, np.float32(0.0))
    if camera.shape == target.camera.shape:
        return target.contact.copy(), np.where(usable, depth_mm, np.float32(np.nan))
    size = (camera.cols, camera.rows)
    contact_share, share, depth_mm = (
        np.asarray(cv2.resize(a.astype(np.float32), size, interpolation=cv2.INTER_AREA))
        for a in (target.contact, usable, depth_mm)
    )
    contact = contact_share >= 0.5
    mean = np.divide(
        depth_mm, share, out=np.full(share.shape, np.nan, np.float32), where=contact & (share > 0)
    )
    return contact, mean
