"""Register one moved membrane to another without a mesh: Gauss-Newton on distances, normals and the
contact's outline.

The motion T takes a point p with normal n of the key frame to T p in the current frame, where the
membrane has the point s and the normal m. Per point, the second as in NormalFlow (Huang, Kaess,
Yuan 2024):

    d = m . (s - T p)          distance along the current normal, in mm
    e = m - R n                difference of the normals
    o = b(T p) - a(p)          difference of the distances to either contact's outline, in mm

each in units of its expected error. A bubble's smooth membrane shows a turn of the object by the
outline alone. Residuals that do not move along with the object weigh little, after Geman and
McClure. Motions that the surface does not determine, such as a slide along a straight rod, keep the
prediction (`assess_observability`).
"""

import math
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import Doubles, Mask, freeze
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
from pipeline.stages.pose.registration.observability import (
    Observability,
    Tolerances,
    assess_observability,
    compute_correlated_covariance,
    estimate_systematic_error,
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


_ITERATIONS = 12
# motion of the moved part that ends the iterations, on the coarse and on the fine level
_CONVERGENCE_MM = (2e-2, 2e-3)
_COVARIANCE_POINTS = 200  # whose errors are correlated with each other
_OUTLIER_FACTOR = 4.0  # residuals whose square is this many times the median weigh a quarter
# A motion counts as measured where its predicted error is below these; an outline's normals are 6
# degrees off.
_TOLERANCES = Tolerances(mm=0.5, deg=4.0, normal_error_deg=6.0)
_DAMPING = 1e-6  # share of the information: keeps the solution finite


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceFit:
    """The motion between two frames."""

    current_from_key: Doubles  # (4, 4) mm, in the sensor frame
    # (6, 6) of (rotation rad, translation mm) about the centroid of the moved part
    covariance: Doubles
    centre_mm: Doubles  # (3,) that centroid, in the current frame
    weak_directions: tuple[str, ...]  # motions that were predicted, not measured
    overlap: float  # share of the key frame's points that lie on the current frame's moved part
    agreement: float  # share of those whose residuals are as small as expected


def register_surfaces(
    key: MembraneSurface, current: MembraneSurface, start: Doubles, first_level: int = 0
) -> SurfaceFit | None:
    """The motion near `start` (4, 4) that takes the key frame's membrane to the current one's.

    It begins on `first_level` (0 = coarse). None where too little of the key frame is inside the
    current image.
    """
    motion = start
    residuals = None
    seen = None
    for level in range(first_level, len(key.levels)):
        there = sample_key_points(key, level)
        for _ in range(_ITERATIONS):
            residuals = compute_residuals(there, current, level, motion)
            if residuals is None:
                return None
            if seen is None:
                seen = _assess(residuals, key)
            step = seen.observable @ _solve(residuals)
            motion = _move(motion, step, residuals.centre_mm)
            if (
                np.linalg.norm(step[3:]) + _radius_mm(residuals) * np.linalg.norm(step[:3])
                < _CONVERGENCE_MM[level]
            ):
                break
    assert residuals is not None
    assert seen is not None
    return _describe(motion, residuals, key, seen)


def measure_overlap(key: MembraneSurface, current_from_key: Doubles) -> float:
    """Share of the key frame's points that lie inside the image after a motion."""
    there = sample_key_points(key, len(key.levels) - 1)
    moved = rigid.apply(current_from_key, there.surface.points_mm)
    return float(key.camera.project(moved)[2].mean()) if len(moved) else 0.0


def _weigh(residuals: Residuals) -> Doubles:
    """Weights (n,): 0 outside the moved part, small for outliers."""
    error_sq = residuals.error_sq
    typical = max(float(np.median(error_sq)), 1.0)
    return residuals.on_moved / (1.0 + error_sq / (_OUTLIER_FACTOR * typical)) ** 2


def _solve(residuals: Residuals) -> Doubles:
    """The motion (6,) that the linearised residuals ask for."""
    root = np.sqrt(_weigh(residuals))
    columns = (residuals.by_motion * root).reshape(6, -1)
    wanted = (residuals.errors * root).ravel()
    information = columns @ columns.T
    information += _DAMPING * np.diag(np.diag(information) + 1e-12)
    return np.asarray(-np.linalg.solve(information, columns @ wanted), np.float64)


def _move(motion: Doubles, step: Doubles, centre_mm: Doubles) -> Doubles:
    """`motion` followed by a small motion about a centre; its rotation stays orthonormal."""
    moved = rigid.rotation(step[:3])
    moved[:3, 3] = centre_mm + step[3:] - moved[:3, :3] @ centre_mm
    return rigid.orthonormalise(moved @ motion)


def _radius_mm(residuals: Residuals) -> float:
    return math.sqrt(
        float(((residuals.here.points_mm - residuals.centre_mm) ** 2).sum(axis=1).mean())
    )


def _assess(residuals: Residuals, key: MembraneSurface) -> Observability:
    points, normals = _collect_constraints(residuals)
    systematic = estimate_systematic_error(points, normals, residuals.centre_mm, key.error)
    return assess_observability(
        points,
        normals,
        residuals.centre_mm,
        key.error.rms_mm,
        systematic_error=systematic,
        tolerances=_TOLERANCES,
    )


def _collect_constraints(residuals: Residuals) -> tuple[Doubles, Doubles]:
    """Points and the directions (n, 3) along which each is held: the membrane's normals, and the
    outline's.
    """
    held = np.isfinite(residuals.outline_normals[:, 0])
    return (
        np.concatenate([residuals.here.points_mm, residuals.here.points_mm[held]]),
        np.concatenate([residuals.here.normals, residuals.outline_normals[held]]),
    )


def _describe(
    motion: Doubles, residuals: Residuals, surface: MembraneSurface, seen: Observability
) -> SurfaceFit:
    on = residuals.on_moved > 0
    small = on & (residuals.error_sq < _OUTLIER_FACTOR**2)
    points, normals = _collect_constraints(residuals)
    some = np.s_[:: max(1, len(points) // _COVARIANCE_POINTS)]
    covariance = compute_correlated_covariance(
        points[some],
        normals[some],
        residuals.centre_mm,
        seen.observable,
        noise_mm=surface.error.rms_mm,
        error=surface.error,
    )
    return SurfaceFit(
        current_from_key=freeze(motion),
        centre_mm=freeze(residuals.centre_mm),
        covariance=freeze((1.0 + 1.0 / surface.n_frames) * covariance),
        weak_directions=seen.weak_directions,
        overlap=float(on.sum()) / max(residuals.n_points, 1),
        agreement=float(small.sum()) / max(int(on.sum()), 1),
    )
