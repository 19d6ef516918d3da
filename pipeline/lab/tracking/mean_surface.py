"""Average the membranes of frames of one place of an object: one frame's noise would be in all
motions from it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.core.arrays import Doubles, Mask, freeze
from pipeline.lab.tracking.membrane_surface import (
    OUTLINE_REACH_MM,
    RIM_MM,
    MembraneSurface,
    choose_pixels,
    smooth_levels,
)

_MARGIN_MM = 3.0  # around the key frame's moved part: nothing farther out is averaged
_SEEN_SHARE = 0.3  # of the frames: a place that fewer see is not of the mean's moved part


def average_surfaces(
    key: MembraneSurface, surfaces: Sequence[MembraneSurface], current_from_key: Sequence[Doubles]
) -> MembraneSurface:
    """The mean membrane of several frames on the key frame's pixels, of their depth and of their
    outlines.
    """
    import cv2

    rows, cols = _find_window(key)
    filled = np.where(
        np.isfinite(key.depth_mm), key.depth_mm, np.float32(np.nanmedian(key.depth_mm))
    )
    ray_y, ray_x = np.meshgrid(
        (np.arange(rows.start, rows.stop) - key.camera.cy_px) / key.camera.fy_px,
        (np.arange(cols.start, cols.stop) - key.camera.cx_px) / key.camera.fx_px,
        indexing="ij",
    )
    rays = np.stack([ray_x, ray_y, np.ones_like(ray_x)], axis=-1)
    points = rays * np.asarray(cv2.GaussianBlur(filled, (0, 0), 1.0), np.float64)[rows, cols, None]
    depth_sum, outline_sum, n_seen = (np.zeros(points.shape[:2]) for _ in range(3))
    for surface, motion in zip(surfaces, current_from_key, strict=True):
        depth_mm, outline_mm, seen = _warp(surface, motion, points)
        depth_sum += depth_mm
        outline_sum += outline_mm
        n_seen += seen
    mean_mm = filled.copy()
    outline_mm = key.outline_mm.copy()
    contact = np.zeros(key.contact.shape, np.bool_)
    n = np.maximum(n_seen, 1.0)
    mean_mm[rows, cols] = np.where(n_seen > 0, depth_sum / n, filled[rows, cols])
    often = n_seen >= _SEEN_SHARE * len(surfaces)
    outline_mm[rows, cols] = np.where(often, outline_sum / n, OUTLINE_REACH_MM)
    contact[rows, cols] = often & (outline_mm[rows, cols] < 0)
    off_px = cv2.distanceTransform((~contact).astype(np.uint8), cv2.DIST_L2, 5)
    moved: Mask = off_px * np.float32(key.pixel_mm) <= RIM_MM if contact.any() else contact
    return replace(
        key,
        levels=smooth_levels(mean_mm, key.pixel_mm),
        moved=freeze(moved.astype(np.float32)),
        contact=freeze(contact),
        outline_mm=freeze(outline_mm),
        depth_mm=freeze(mean_mm),
        pixels=choose_pixels(moved),
        n_frames=len(surfaces),
    )


def _find_window(key: MembraneSurface) -> tuple[slice, slice]:
    """Rows and columns of the key frame's moved part with a margin."""
    margin_px = round(_MARGIN_MM / key.pixel_mm)
    rows, cols = (np.flatnonzero(key.moved.any(axis=axis)) for axis in (1, 0))
    return (
        slice(
            max(int(rows[0]) - margin_px, 0), min(int(rows[-1]) + margin_px + 1, key.camera.rows)
        ),
        slice(
            max(int(cols[0]) - margin_px, 0), min(int(cols[-1]) + margin_px + 1, key.camera.cols)
        ),
    )


def _warp(
    surface: MembraneSurface, motion: Doubles, points_mm: Doubles
) -> tuple[Doubles, Doubles, Mask]:
    """(depth in the key frame, distance to the outline, seen) of a frame at the key frame's points.

    0 where unseen.
    """
    import cv2

    camera = surface.camera
    moved = points_mm @ motion[:3, :3].T + motion[:3, 3]
    x, y = (
        (focal * moved[..., axis] / moved[..., 2] + centre).astype(np.float32)
        for axis, focal, centre in (
            (0, camera.fx_px, camera.cx_px),
            (1, camera.fy_px, camera.cy_px),
        )
    )
    depth, outline = (
        np.asarray(
            cv2.remap(
                image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan
            )
        )
        for image in (surface.depth_mm, surface.outline_mm)
    )
    seen = np.isfinite(depth) & np.isfinite(outline)
    # The frame's point on the same ray, brought back: only its depth is averaged.
    point = moved * (depth / moved[..., 2])[..., None] - motion[:3, 3]
    back = point @ motion[:3, 2]
    return np.where(seen, back, 0.0), np.where(seen, outline, 0.0), seen
