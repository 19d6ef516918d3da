"""Residuals between two moved membranes, and their change by a motion of the object.

The motion T takes a point p with normal n of the key frame to T p in the current frame, where the
membrane has the point s and the normal m. Per point, the second as in NormalFlow (Huang, Kaess,
Yuan 2024):

    d = m . (s - T p)          distance along the current normal, in mm
    e = m - R n                difference of the normals
    o = b(T p) - a(p)          difference of the distances to either contact's outline, in mm

each in units of its expected error. A bubble's smooth membrane shows a turn of the object by the
outline alone.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import Doubles, Mask
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.lab.tracking.membrane_surface import (
    MIN_POINTS,
    N_POINTS,
    OUTLINE_REACH_MM,
    LocalSurface,
    MembraneSurface,
    sample_outline,
    sample_surface,
)

# least expected errors, which weigh the residuals
_DISTANCE_MM = 0.02
_NORMAL_RAD = 0.05
_OUTLINE_MM = 0.1
_OUTLINE_PX = 1.0  # an outline is known to a pixel
# change of the distance to the outline per mm: 1 where it is straight, less where it is confused
_DISTINCT = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class Residuals:
    """Residuals and their derivatives by (rotation rad, translation mm) about a centre.

    Points last, for speed.
    """

    centre_mm: Doubles  # (3,)
    errors: Doubles  # (5, n): distance, normal, outline, each in units of its expected error
    by_motion: Doubles  # (6, 5, n) their change by the motion
    outline_normals: Doubles  # (n, 3) of the contact's outline where it is near, else NaN
    here: LocalSurface
    on_moved: Doubles  # (n,) 1 on the current frame's moved part
    n_points: int  # of the key frame

    @property
    def error_sq(self) -> Doubles:
        """Squared residual (n,) in units of the expected errors."""
        return (self.errors**2).sum(axis=0)


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyPoints:
    """The key frame's points of one level, and the expected errors of residuals."""

    surface: LocalSurface
    outline_mm: Doubles  # (n,)
    expected: Doubles  # (3,) of distance (mm), normal (rad) and outline (mm)


def sample_key_points(key: MembraneSurface, level: int) -> KeyPoints:
    """The key frame's points on a level (0 = coarse) as far as they are inside its margin."""
    smooth = key.levels[level]
    is_fine = level == len(key.levels) - 1
    # a coarse pose is only a start
    some = key.pixels[:: 1 if is_fine or len(key.pixels) <= N_POINTS // 2 else 2]
    pixels = some[find_inside(some, key, smooth.margin_px)]
    rms_mm = key.error.rms_mm
    return KeyPoints(
        surface=sample_surface(smooth, key.camera, pixels),
        outline_mm=sample_outline(key.outline_mm, pixels)[0],
        expected=np.array(
            [
                max(_DISTANCE_MM, rms_mm),
                max(_NORMAL_RAD, rms_mm / key.error.correlation_mm),
                max(_OUTLINE_MM, _OUTLINE_PX * key.pixel_mm),
            ]
        ),
    )


def find_inside(pixels: Doubles, surface: MembraneSurface, margin_px: float) -> Mask:
    """Which pixels (n, 2) x, y are at least `margin_px` inside the image."""
    x = pixels[:, 0]
    y = pixels[:, 1]
    far_x = surface.camera.cols - 1 - margin_px
    far_y = surface.camera.rows - 1 - margin_px
    return (x >= margin_px) & (x <= far_x) & (y >= margin_px) & (y <= far_y)


def compute_residuals(
    key: KeyPoints, current: MembraneSurface, level: int, motion: Doubles
) -> Residuals | None:
    """The residuals after a motion (4, 4).

    None where too few points are inside the current image.
    """
    camera = current.camera
    smooth = current.levels[level]
    points = rigid.apply(motion, key.surface.points_mm)
    x_px, y_px, in_front = camera.project(points)
    pixels = np.column_stack([x_px, y_px])
    usable = in_front & find_inside(pixels, current, smooth.margin_px)
    if usable.sum() < MIN_POINTS:
        return None
    points = np.asfortranarray(points[usable])
    pixels = np.asfortranarray(pixels[usable])
    here = sample_surface(smooth, camera, pixels)
    outline_mm, outline_change = sample_outline(current.outline_mm, pixels)
    turned = np.asfortranarray(key.surface.normals[usable] @ motion[:3, :3].T)
    centre = points.mean(axis=0)
    by_x, by_y = (by.T for by in _differentiate_pixels(points, points - centre, camera))
    errors = np.empty((5, len(points)))
    by_motion = np.empty((6, 5, len(points)))
    errors[0] = ((here.points_mm - points) * here.normals).sum(axis=1)
    by_motion[:, 0] = -np.concatenate(
        [_cross(points - centre, here.normals), here.normals], axis=1
    ).T
    errors[1:4] = (here.normals - turned).T
    by_motion[:, 1:4] = (
        here.normals_along_x.T * by_x[:, None] + here.normals_along_y.T * by_y[:, None]
    )
    by_motion[:3, 1:4] += rigid.cross_matrix(turned).T  # R n turns along
    errors[4] = outline_mm - key.outline_mm[usable]
    by_motion[:, 4] = outline_change[:, 0] * by_x + outline_change[:, 1] * by_y
    scale = key.expected[[0, 1, 1, 1, 2], None]
    return Residuals(
        centre_mm=centre,
        errors=errors / scale,
        by_motion=by_motion / scale,
        here=here,
        outline_normals=_find_outline_normals(outline_mm, by_motion[3:, 4].T),
        on_moved=np.round(sample_outline(current.moved, pixels)[0]),
        n_points=len(key.outline_mm),
    )


def _differentiate_pixels(
    points: Doubles, arms: Doubles, camera: Camera
) -> tuple[Doubles, Doubles]:
    """Change (n, 6) of a moving point's pixel, right and down, by (rotation, translation) of the
    point.
    """
    z = points[:, 2]
    along_x = np.zeros_like(points)
    along_y = np.zeros_like(points)
    along_x[:, 0] = camera.fx_px / z
    along_x[:, 2] = -camera.fx_px * points[:, 0] / z**2
    along_y[:, 1] = camera.fy_px / z
    along_y[:, 2] = -camera.fy_px * points[:, 1] / z**2
    return (
        np.concatenate([_cross(arms, along_x), along_x], axis=1),
        np.concatenate([_cross(arms, along_y), along_y], axis=1),
    )


def _cross(one: Doubles, two: Doubles) -> Doubles:
    """The cross product of rows (n, 3): `np.cross` takes four times as long for so few."""
    (ax, ay, az), (bx, by, bz) = one.T, two.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]).T


def _find_outline_normals(outline_mm: Doubles, change: Doubles) -> Doubles:
    """Unit normals (n, 3) of the outline where it is near and distinct; NaN elsewhere."""
    steep = np.linalg.norm(change, axis=1)
    near = (np.abs(outline_mm) < 0.5 * OUTLINE_REACH_MM) & (steep > _DISTINCT)
    return np.where(near[:, None], change / np.maximum(steep, _DISTINCT)[:, None], np.nan)
