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

Around a contact the membrane bends with the object, so a rim of its moved part takes part, not the
contact alone: the flat face of a tool shows its motion only where the membrane bends around its
edge. Farther out a bubble's membrane follows its own rim.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Mask, freeze
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.values.results import DepthErrorModel, DepthMap
from pipeline.stages.pose.registration.observability import (
    Observability,
    Tolerances,
    assess_observability,
    compute_correlated_covariance,
    estimate_systematic_error,
)

# where a depth map does not state its error
COMPUTED = DepthErrorModel(rms_mm=0.01, correlation_mm=0.5)
N_POINTS = 800  # of a surface: twice as many change a pose by a fifth of its uncertainty
MIN_POINTS = 60  # fewer moved pixels are no touch that could be followed
# moved: indented by this share of the touch, and at least by that much
_MOVED_SHARE = 0.15
_MOVED_MM = 0.03
RIM_MM = 0.8  # moved part around the contact that takes part
# standard deviation of the fine level, at least 1 px; that of the coarse one
_SMOOTHING_MM = 0.08
_COARSER = 3.0
_MAX_SMOOTHING_PX = 10.0  # pixels of no depth have no width
OUTLINE_REACH_MM = 1.0  # distances to the contact's outline are cut off here
_STENCIL_PX = 2  # normals and their change along the image reach this far
# Offsets of depth samples: the pixel, its neighbours, and theirs.
_OFFSETS = (
    (0, 0),
    (1, 0),
    (-1, 0),
    (0, 1),
    (0, -1),
    (2, 0),
    (-2, 0),
    (0, 2),
    (0, -2),
    (1, 1),
    (1, -1),
    (-1, 1),
    (-1, -1),
)
# Of those, the samples right, left, below and above each of the pixel and its four neighbours.
_NEIGHBOURS = ((1, 2, 3, 4), (5, 0, 9, 10), (0, 6, 11, 12), (9, 11, 7, 0), (10, 12, 0, 8))


@frozen
class SmoothedDepth:
    """A depth image after a Gaussian filter, and how near to the image's border its values are
    usable.
    """

    depth_mm: Floats  # (rows, cols)
    margin_px: float  # the filter mixes in what is beyond the border


@frozen
class LocalSurface:
    """The surface at some image positions."""

    points_mm: Doubles  # (n, 3)
    normals: Doubles  # (n, 3) unit, toward the camera
    normals_along_x: Doubles  # (n, 3) change of the normal per pixel to the right
    normals_along_y: Doubles  # (n, 3) per pixel down


@frozen
class MembraneSurface:
    """The moved part of one frame's membrane, in the sensor frame."""

    camera: Camera
    levels: tuple[SmoothedDepth, ...]  # coarse, fine
    moved: Floats  # (rows, cols) 1 where the membrane is moved, else 0
    outline_mm: Floats  # (rows, cols) distance to the contact's outline, negative inside
    contact: Mask  # (rows, cols)
    depth_mm: Floats  # (rows, cols) as measured; NaN = no value
    pixels: Doubles  # (n, 2) x, y of chosen moved pixels
    error: DepthErrorModel
    pixel_mm: float  # width of a pixel on the membrane
    n_frames: int = 1  # that it is the mean of

    @property
    def is_touched(self) -> bool:
        """Whether enough of the membrane is moved to be followed."""
        return len(self.pixels) >= MIN_POINTS


def make_surface(depth: DepthMap) -> MembraneSurface:
    """The surface of a depth map; the same map gives the same points."""
    import cv2

    known = np.isfinite(depth.depth_mm) & np.isfinite(depth.indentation_mm)
    indentation = np.where(known, depth.indentation_mm, np.float32(0.0))
    typical_mm = float(np.median(depth.depth_mm[known])) if known.any() else 0.0
    filled: Floats = np.where(known, depth.depth_mm, np.float32(typical_mm))
    pixel_mm = typical_mm / depth.camera.fx_px
    inside_px, outside_px = (
        cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
        for mask in (depth.contact, ~depth.contact)
    )
    moved = np.zeros(known.shape, np.bool_)
    if depth.contact.any():
        least_mm = _MOVED_SHARE * float(np.percentile(indentation[depth.contact], 90.0))
        moved = (outside_px * np.float32(pixel_mm) <= RIM_MM) & (
            indentation > max(_MOVED_MM, least_mm)
        )
    # signed distance to the contact's outline, smoothed over a pixel
    apart = np.clip(
        (outside_px - inside_px) * np.float32(pixel_mm), -OUTLINE_REACH_MM, OUTLINE_REACH_MM
    )
    fine_px = _find_fine_px(pixel_mm)
    if not known.all():
        unknown_px = cv2.distanceTransform(known.astype(np.uint8), cv2.DIST_L2, 3)
        moved &= unknown_px > 2.5 * fine_px
    return MembraneSurface(
        camera=depth.camera,
        levels=smooth_levels(filled, pixel_mm),
        moved=moved.astype(np.float32),
        contact=depth.contact,
        outline_mm=np.asarray(cv2.GaussianBlur(apart, (0, 0), 1.0), np.float32),
        depth_mm=depth.depth_mm,
        pixels=choose_pixels(moved),
        error=depth.error or COMPUTED,
        pixel_mm=pixel_mm,
    )


def choose_pixels(moved: Mask) -> Doubles:
    """At most `N_POINTS` x, y (n, 2) of the moved pixels; the same mask gives the same ones."""
    pixels = np.argwhere(moved)[:, ::-1].astype(np.float64)
    n = len(pixels)
    if n > N_POINTS:
        # no stripes of a regular choice
        order = np.random.default_rng(0).permutation(n)
        pixels = pixels[order[np.linspace(0, n - 1, N_POINTS).astype(np.intp)]]
    return freeze(pixels)


def _find_fine_px(pixel_mm: float) -> float:
    return min(max(1.0, _SMOOTHING_MM / max(pixel_mm, 1e-9)), _MAX_SMOOTHING_PX)


def smooth_levels(depth_mm: Floats, pixel_mm: float) -> tuple[SmoothedDepth, ...]:
    """The coarse and the fine level of a depth image without gaps."""
    import cv2

    fine_px = _find_fine_px(pixel_mm)
    return tuple(
        SmoothedDepth(
            depth_mm=np.asarray(cv2.GaussianBlur(depth_mm, (0, 0), sigma_px), np.float32),
            margin_px=2.5 * sigma_px + _STENCIL_PX,
        )
        for sigma_px in (_COARSER * fine_px, fine_px)
    )


def sample_outline(outline_mm: Floats, pixels: Doubles) -> tuple[Doubles, Doubles]:
    """Distances (n,) to the outline at image positions (n, 2), and their change (n, 2) per pixel
    right and down.
    """
    offsets = np.array(_OFFSETS[:5], np.float64)
    x, y = (pixels[:, k] + offsets[:, k, None] for k in (0, 1))
    apart = _interpolate(outline_mm, x, y)
    return apart[0], 0.5 * np.column_stack([apart[1] - apart[2], apart[3] - apart[4]])


def sample_surface(level: SmoothedDepth, camera: Camera, pixels: Doubles) -> LocalSurface:
    """Points, normals and their change at image positions (n, 2) x, y, which lie inside the
    level's margin.
    """
    offsets = np.array(_OFFSETS, np.float64)
    x, y = (pixels[:, k] + offsets[:, k, None] for k in (0, 1))  # (13, n)
    z = _interpolate(level.depth_mm, x, y)
    ray_x = (x - camera.cx_px) / camera.fx_px
    ray_y = (y - camera.cy_px) / camera.fy_px
    right, left, below, above = (list(side) for side in zip(*_NEIGHBOURS, strict=True))
    # With p = fx z_x / z and q = fy z_y / z, a pinhole's depth image has the normal (p, q, -(1 + p
    # x/z + q y/z)).
    p = 0.5 * camera.fx_px * (z[right] - z[left]) / z[:5]
    q = 0.5 * camera.fy_px * (z[below] - z[above]) / z[:5]
    # (5, 3, n): fast along the points
    normals = np.stack([p, q, -(1.0 + p * ray_x[:5] + q * ray_y[:5])], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return LocalSurface(
        points_mm=np.stack([ray_x[0] * z[0], ray_y[0] * z[0], z[0]]).T,
        normals=normals[0].T,
        normals_along_x=0.5 * (normals[1] - normals[2]).T,
        normals_along_y=0.5 * (normals[3] - normals[4]).T,
    )


def _interpolate(image: Floats, x_px: Doubles, y_px: Doubles) -> Doubles:
    """Values of an image at positions of any shape, also of none, which OpenCV refuses."""
    import cv2

    if not x_px.size:
        return np.zeros(x_px.shape)
    return cv2.remap(
        image, x_px.astype(np.float32), y_px.astype(np.float32), cv2.INTER_LINEAR
    ).astype(np.float64)


_MARGIN_MM = 3.0  # around the key frame's moved part: nothing farther out is averaged
_SEEN_SHARE = 0.3  # of the frames: a place that fewer see is not of the mean's moved part


def average_surfaces(
    key: MembraneSurface, surfaces: Sequence[MembraneSurface], current_from_key: Sequence[Doubles]
) -> MembraneSurface:
    """The mean membrane of several frames on the key frame's pixels, of their depth and of their
    outlines.
    """
    import cv2

    # rows and columns of the key frame's moved part with a margin
    margin_px = round(_MARGIN_MM / key.pixel_mm)
    seen_at = (np.flatnonzero(key.moved.any(axis=axis)) for axis in (1, 0))
    rows, cols = (
        slice(max(int(at[0]) - margin_px, 0), int(at[-1]) + margin_px + 1) for at in seen_at
    )
    filled = np.where(
        np.isfinite(key.depth_mm), key.depth_mm, np.float32(np.nanmedian(key.depth_mm))
    )
    smooth = np.asarray(cv2.GaussianBlur(filled, (0, 0), 1.0), np.float32)
    points = key.camera.back_project(smooth)[rows, cols]
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


def _warp(
    surface: MembraneSurface, motion: Doubles, points_mm: Doubles
) -> tuple[Doubles, Doubles, Mask]:
    """(depth in the key frame, distance to the outline, seen) of a frame at the key frame's points.

    0 where unseen.
    """
    import cv2

    moved = rigid.apply(motion, points_mm)
    x, y = (at.astype(np.float32) for at in surface.camera.project(moved)[:2])
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


# least expected errors, which weigh the residuals
_DISTANCE_MM = 0.02
_NORMAL_RAD = 0.05
_OUTLINE_MM = 0.1
_OUTLINE_PX = 1.0  # an outline is known to a pixel
# change of the distance to the outline per mm: 1 where it is straight, less where it is confused
_DISTINCT = 0.3


@frozen
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


@frozen
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
    far = np.array(surface.camera.shape[::-1]) - 1 - margin_px
    return np.asarray(((pixels >= margin_px) & (pixels <= far)).all(axis=1), np.bool_)


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
    x, y, z = points.T
    fx, fy, zero = camera.fx_px, camera.fy_px, np.zeros_like(z)
    along_x = np.stack([fx / z, zero, -fx * x / z**2]).T
    along_y = np.stack([zero, fy / z, -fy * y / z**2]).T
    by_x, by_y = (
        np.concatenate([_cross(arms, along), along], axis=1) for along in (along_x, along_y)
    )
    return by_x, by_y


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


@frozen
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
            about = residuals.centre_mm
            motion = rigid.orthonormalise(rigid.apply_screw(motion, step, about))
            radius_mm = np.sqrt(((residuals.here.points_mm - about) ** 2).sum(axis=1).mean())
            moved_mm = np.linalg.norm(step[3:]) + radius_mm * np.linalg.norm(step[:3])
            if moved_mm < _CONVERGENCE_MM[level]:
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


def _assess(residuals: Residuals, key: MembraneSurface) -> Observability:
    held = *_collect_constraints(residuals), residuals.centre_mm
    systematic = estimate_systematic_error(*held, key.error)
    return assess_observability(
        *held, key.error.rms_mm, systematic_error=systematic, tolerances=_TOLERANCES
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
