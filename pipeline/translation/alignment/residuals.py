"""Residuals of a paired touch under an alignment: two kinds of distances without bias.

*Surface.* Where both membranes touch the object they lie on the same rigid surface, whatever their
stiffness. So a contact point of the source, transferred, lies on the target's measured surface: its
distance along that surface's normal, only where the target is in contact too.

*Outline.* A softer sensor has more contact, so outlines differ; but they grow on all sides. So each
touch may have its own growth, with a weak prior at 0, and the residual is the signed distance
beyond it: the outline's place, not its size.

Normal equations of the alignment over many touches, with a robust loss and a growth of each
touch's outline.

Unknowns are six: a rotation about a pivot and a translation, in units of the tolerance (1 deg, 0.2
mm), so that all directions compare. Loss: Geman-McClure, s^2 r^2 / (s^2 + r^2), with a scale s for
each kind.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pipeline.core.arrays import Doubles, Mask
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.core.geometry.normals import compute_area_vectors
from pipeline.core.values.results import DepthMap
from pipeline.translation.alignment.touches import AlignmentTouch

SURFACE_POINTS = 600  # per touch; more add no information
OUTLINE_POINTS = 300
_NORMAL_BLUR_MM = 0.5  # smoothing of the surface that normals are taken from
_BORDER_PX = 2  # an outline this near to the border is the image's end
_INSIDE_PX = 1.0  # margin within the target's contact: its rim is half air


@frozen
class Evidence:
    """Points of the source and fields of the target of one touch, independent of the alignment."""

    index: int
    surface_mm: Doubles  # (n, 3) contact points, frame of the described source
    outline_mm: Doubles  # (m, 3) points between a contact pixel and a free one
    # (3,) offset of the target instance's camera against the described one
    instance_shift_mm: Doubles
    camera: Camera  # of the target
    depth_mm: Doubles  # (rows, cols) of the target in its own camera; NaN outside its contact
    normal: Doubles  # (rows, cols, 3) unit, of the target's surface
    # (rows, cols) signed distance to the target's contact outline, negative inside
    outside_px: Doubles


@frozen
class Distances:
    """Distances of one kind and their derivatives by the points."""

    mm: Doubles  # (k,)
    jacobian: Doubles  # (k, 3) d mm / d point
    points_mm: Doubles  # (k, 3) target frame
    n_points: int  # all points; those with nothing to compare with are not among the k


def collect_evidence(touch: AlignmentTouch) -> Evidence:
    """Collect what does not depend on the alignment."""
    target = touch.target
    usable = target.contact & np.isfinite(target.depth_mm)
    depth = np.where(usable, target.depth_mm, np.nan).astype(np.float64)
    lift = np.array([0.0, 0.0, touch.source_shift_mm])
    return Evidence(
        index=touch.index,
        surface_mm=_surface_points(touch.source) + lift,
        outline_mm=_outline_points(touch.source) + lift,
        instance_shift_mm=np.array([0.0, 0.0, touch.target_shift_mm]),
        camera=target.camera,
        depth_mm=depth,
        normal=_normals(depth, target.camera),
        outside_px=_outside_px(target.contact),
    )


def thin_points(touch: Evidence, points: int) -> Evidence:
    """Return the evidence with at most about `points` points of each kind."""
    surface, outline = (
        p[:: max(1, len(p) // points)] for p in (touch.surface_mm, touch.outline_mm)
    )
    return replace(touch, surface_mm=surface, outline_mm=outline)


def compute_surface_distances(touch: Evidence, points_mm: Doubles) -> Distances:
    """Distances of contact points (n, 3) in the target's camera frame to the target's surface
    along its normal.
    """
    x, y, visible = touch.camera.project(points_mm)
    visible &= points_mm[:, 2] > MIN_DEPTH_MM
    inside = np.zeros(visible.shape, np.bool_)
    inside[visible] = sample_bilinear(touch.outside_px, x[visible], y[visible]) < -_INSIDE_PX
    p = points_mm[inside]
    depth = sample_bilinear(touch.depth_mm, x[inside], y[inside])
    row = np.rint(y[inside]).astype(np.intp)
    col = np.rint(x[inside]).astype(np.intp)
    normal = touch.normal[row, col]
    weights = np.isfinite(depth) & np.isfinite(normal).all(axis=1)
    p = p[weights]
    depth = depth[weights]
    normal = normal[weights]
    # On the ray through p the surface is at p * depth / p_z: the gap lies along the ray.
    gap = (p * (1.0 - depth / p[:, 2])[:, None] * normal).sum(axis=1)
    return Distances(mm=gap, jacobian=normal, points_mm=p, n_points=len(points_mm))


def compute_outline_distances(touch: Evidence, points_mm: Doubles) -> Distances:
    """Distances (mm) of outline points (m, 3) in the target's camera frame to the target's
    outline in its image.
    """
    camera = touch.camera
    x, y, visible = camera.project(points_mm)
    margin = _BORDER_PX
    visible &= (
        (x > margin)
        & (x < camera.cols - 1 - margin)
        & (y > margin)
        & (y < camera.rows - 1 - margin)
    )
    p = points_mm[visible]
    x = x[visible]
    y = y[visible]
    field = touch.outside_px
    h = 0.5
    slope_x = sample_bilinear(field, x + h, y) - sample_bilinear(field, x - h, y)
    slope_y = sample_bilinear(field, x, y + h) - sample_bilinear(field, x, y - h)
    # u = fx X/Z + cx: a motion of p in mm moves its pixel by fx/Z, less Z's share; in mm at the
    # touch's distance.
    ratio = camera.fy_px / camera.fx_px
    jacobian = np.stack(
        [slope_x, slope_y * ratio, -(slope_x * p[:, 0] + slope_y * ratio * p[:, 1]) / p[:, 2]],
        axis=-1,
    )
    return Distances(
        mm=sample_bilinear(field, x, y) * p[:, 2] / camera.fx_px,
        jacobian=jacobian,
        points_mm=p,
        n_points=len(points_mm),
    )


def sample_bilinear(field: Doubles, x_px: Doubles, y_px: Doubles) -> Doubles:
    """Sample a field (rows, cols) bilinearly (k,), clamped at its border.

    NaN where a corner is NaN.
    """
    rows, cols = field.shape
    x = np.clip(x_px, 0.0, cols - 1.0)
    y = np.clip(y_px, 0.0, rows - 1.0)
    col = np.minimum(x.astype(np.intp), cols - 2)
    row = np.minimum(y.astype(np.intp), rows - 2)
    a = x - col
    b = y - row
    flat = field.ravel()
    first = row * cols + col
    top = flat[first] * (1.0 - a) + flat[first + 1] * a
    return np.asarray(
        top * (1.0 - b) + (flat[first + cols] * (1.0 - a) + flat[first + cols + 1] * a) * b
    )


def _surface_points(depth: DepthMap) -> Doubles:
    usable = depth.contact & (depth.depth_mm > MIN_DEPTH_MM) & np.isfinite(depth.depth_mm)
    every = max(1, int(np.ceil(np.sqrt(np.count_nonzero(usable) / SURFACE_POINTS))))
    chosen = np.zeros_like(usable)
    chosen[every // 2 :: every, every // 2 :: every] = True
    row, col = np.nonzero(usable & chosen)
    return depth.camera.back_project_at(
        col.astype(np.float64), row.astype(np.float64), depth.depth_mm[row, col].astype(np.float64)
    )


def _outline_points(depth: DepthMap) -> Doubles:
    """Return points half way between a contact pixel and its free neighbour, at the contact
    pixel's depth.
    """
    contact = depth.contact
    rows, cols = contact.shape
    found: list[Doubles] = []
    for down, right in ((1, 0), (0, 1)):
        row, col = np.nonzero(contact[: rows - down, : cols - right] != contact[down:, right:])
        is_free = ~contact[row, col]
        z = depth.depth_mm[row + down * is_free, col + right * is_free]
        places = [col + 0.5 * right, row + 0.5 * down, z]
        found.append(np.stack(places, axis=-1, dtype=np.float64))
    x, y, z = np.concatenate(found).T
    margin = _BORDER_PX
    kept = (
        (x > margin)
        & (x < cols - 1 - margin)
        & (y > margin)
        & (y < rows - 1 - margin)
        & (z > MIN_DEPTH_MM)
    )
    x = x[kept]
    y = y[kept]
    z = z[kept]
    every = max(1, int(np.ceil(x.size / OUTLINE_POINTS)))
    return depth.camera.back_project_at(x[::every], y[::every], z[::every])


def _normals(depth_mm: Doubles, camera: Camera) -> Doubles:
    """Return unit normals (rows, cols, 3), z > 0, of the smoothed surface.

    NaN where it is unknown.
    """
    import cv2

    known = np.isfinite(depth_mm)
    if not known.any():
        return np.full((*depth_mm.shape, 3), np.nan)
    blur_px = max(_NORMAL_BLUR_MM * camera.fx_px / float(np.median(depth_mm[known])), 0.7)
    share = np.asarray(cv2.GaussianBlur(known.astype(np.float64), (0, 0), blur_px))
    level = float(np.median(depth_mm[known]))
    smooth = np.asarray(cv2.GaussianBlur(np.where(known, depth_mm - level, 0.0), (0, 0), blur_px))
    smooth = level + np.divide(smooth, share, out=np.zeros_like(smooth), where=share > 1e-6)
    normal = -compute_area_vectors(camera.back_project(smooth))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.where(known[..., None], normal, np.nan)


def _outside_px(contact: Mask) -> Doubles:
    """Return the signed distance (rows, cols) in pixels to the contact's outline.

    One sign if all pixels are alike.
    """
    import cv2

    def to(mask: Mask) -> Doubles:
        if mask.all():
            return np.full(mask.shape, float(max(mask.shape)))
        found = cv2.distanceTransform(mask.view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        # OpenCV's last bit depends on how many of its threads are free; squares are whole numbers
        return np.sqrt(np.rint(np.square(found, dtype=np.float64)))

    return np.where(contact, 0.5 - to(contact), to(~contact) - 0.5)


TOLERANCE_MM = 0.2  # predicted std above which a direction counts as undetermined
TOLERANCE_DEG = 1.0
# (rad, mm) of one unit
TOLERANCE_UNITS = np.array([math.radians(TOLERANCE_DEG)] * 3 + [TOLERANCE_MM] * 3)
_INDEPENDENT_IN_TOUCH = (
    # independent measurements of each kind in a touch: errors within a millimetre are correlated
    8.0
)
_SHARED_ERROR_TOUCHES = (
    # this many touches have half the weight of any number: a sensor's error is alike in all of them
    4.0
)
_GROWTH_MM = 0.5  # expected growth of an outline from one sensor to the other
# mm, of surface and outline as all pairs below: calibration and pixels; avoids a zero covariance
_MIN_NOISE = np.array([0.02, 0.1])
_ITERATIONS = 3  # iterations of estimating a touch's growth


_COMPARISON_NOISE = np.array([0.2, 0.4])
_COMPARISON_SCALE = np.array([1.0, 2.0])


@frozen
class NormalEquations:
    """The quadratic model around one alignment: cost, gradient and J^T W J in units of
    tolerance.
    """

    cost: float
    gradient: Doubles  # (6,)
    information: Doubles  # (6, 6)


class TouchDistances(NamedTuple):
    """The distances of one touch under one alignment."""

    surface: Distances
    outline: Distances


def compute_touch_distances(
    touches: Sequence[Evidence], target_from_source: Doubles
) -> list[TouchDistances]:
    """Compute the distances (mm) of each touch under the described T_S->T."""
    found: list[TouchDistances] = []
    for touch in touches:
        surface, outline = (
            rigid.apply(target_from_source, points) - touch.instance_shift_mm
            for points in (touch.surface_mm, touch.outline_mm)
        )
        found.append(
            TouchDistances(
                compute_surface_distances(touch, surface), compute_outline_distances(touch, outline)
            )
        )
    return found


def estimate_noise(distances: Sequence[TouchDistances]) -> Doubles:
    """Estimate standard deviations (2,) in mm of surface and outline from the median absolute
    deviation over all touches, less the outlines' growth.
    """
    surface = np.concatenate([s.surface.mm for s in distances])
    outline = np.concatenate([s.outline.mm - _median(s.outline.mm) for s in distances])
    deviations = np.array([_median(np.abs(surface)), _median(np.abs(outline))])
    return np.maximum(_MIN_NOISE, 1.4826 * deviations)


def estimate_growth_mm(
    outline_mm: Doubles, scale_mm: float, noise_mm: float, n_asked: int
) -> tuple[float, float]:
    """Return how much wider (mm) a touch's outline is than its partner's, and 1 / variance of
    that.
    """
    each = _INDEPENDENT_IN_TOUCH / (max(n_asked, 1) * noise_mm**2)
    growth = _median(outline_mm)
    certainty = _GROWTH_MM**-2
    for _ in range(_ITERATIONS):
        weight = _weights(outline_mm - growth, scale_mm)
        certainty = each * float(weight.sum()) + _GROWTH_MM**-2
        growth = each * float(weight @ outline_mm) / certainty
    return growth, certainty


def accumulate_sums(
    distances: Sequence[TouchDistances],
    touches: Sequence[Evidence],
    pivot_mm: Doubles,
    noise: Doubles,
    scale: Doubles,
) -> NormalEquations:
    """Accumulate cost, gradient and information over all touches with equal weight.

    `noise` and loss `scale` (2,) are of surface and outline, mm.
    """
    total = 0.0
    gradient = np.zeros(6)
    information = np.zeros((6, 6))
    independent = _INDEPENDENT_IN_TOUCH / (1.0 + len(touches) / _SHARED_ERROR_TOUCHES)
    for one, touch in zip(distances, touches, strict=True):
        lift = touch.instance_shift_mm - pivot_mm
        for d, sigma, s, grows in zip(
            one, noise.tolist(), scale.tolist(), (False, True), strict=True
        ):
            if d.n_points == 0:
                continue
            each = independent / (d.n_points * sigma**2)
            growth, certainty = (
                estimate_growth_mm(d.mm, s, sigma, d.n_points) if grows else (0.0, math.inf)
            )
            gap = d.mm - growth
            weight = _weights(gap, s)
            jacobian = (
                np.concatenate([np.cross(d.points_mm + lift, d.jacobian), d.jacobian], axis=1)
                * TOLERANCE_UNITS
            )
            weighted = jacobian * weight[:, None]
            pull = each * weighted.sum(axis=0)
            gradient += each * (weighted.T @ gap)
            information += each * (weighted.T @ jacobian) - np.outer(pull, pull) / certainty
            # A point with nothing to compare costs as much as an outlier: leaving the view is no
            # gain.
            lost = s * s * (d.n_points - len(d.mm))
            total += each * (float((s * s * gap * gap / (s * s + gap * gap)).sum()) + lost)
            total += (growth / _GROWTH_MM) ** 2
    return NormalEquations(cost=total, gradient=gradient, information=information)


def compute_cost(touches: Sequence[Evidence], target_from_source: Doubles) -> float:
    """Return the cost that `accumulate_sums` minimises, at a fixed noise and scale, so that
    different alignments compare.
    """
    distances = compute_touch_distances(touches, target_from_source)
    return accumulate_sums(
        distances, touches, np.zeros(3), _COMPARISON_NOISE, _COMPARISON_SCALE
    ).cost


def _weights(gap_mm: Doubles, scale_mm: float) -> Doubles:
    ratio = scale_mm**2 / (scale_mm**2 + gap_mm**2)
    return ratio * ratio


def _median(values: Doubles) -> float:
    return float(np.median(values)) if values.size else 0.0
