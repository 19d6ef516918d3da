"""The contact circle of a ball from the colour change alone, and the sphere nearest to its
measured surface.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Mask

_NOISE_FACTOR = 6.0  # times the median change of the image: certainly touched
_SHARE_OF_PEAK = 0.35
_PATCH_MIN_PX = 60  # smallest area of a ball
# of a sphere that is fitted
_CONTACT_PX_MIN = 20
_FIRST_RADIUS_MM = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Circle:
    """A circle in the image."""

    x_px: float
    y_px: float
    radius_px: float


def detect_contact_circle(change: Floats) -> Circle | None:
    """An initial circle from a colour change (rows, cols, 3): centre of the changed patch, radius
    of its steepest ring.

    At the edge of a contact the slope is largest (Hertz), and so is the colour change. None without
    a clear patch.
    """
    import cv2

    strength = np.linalg.norm(np.asarray(cv2.GaussianBlur(change, (0, 0), 2.0)), axis=2).astype(
        np.float32
    )
    limit = max(
        _NOISE_FACTOR * float(np.median(strength)),
        _SHARE_OF_PEAK * float(np.percentile(strength, 99.8)),
    )
    patch = _find_largest_patch(strength > limit)
    if patch is None:
        return None
    outline = _fit_outline_circle(patch)
    radii, profile = compute_ring_profile(strength, outline, 1.3 * outline.radius_px)
    # Near the centre a ball can be brighter than at its rim: only the outer part counts.
    outer = radii >= 0.4 * outline.radius_px
    if not outer.any():
        return None
    return Circle(
        x_px=outline.x_px,
        y_px=outline.y_px,
        radius_px=float(radii[outer][int(np.argmax(profile[outer]))]),
    )


def find_largest_part(mask: Mask) -> Mask:
    """The largest connected part of a mask (rows, cols), empty where the mask is."""
    import cv2

    n, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    return labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])) if n > 1 else mask


def compute_ring_profile(
    values: Floats, circle: Circle, reach_px: float
) -> tuple[Doubles, Doubles]:
    """Median of `values` (rows, cols) on rings one pixel wide about the circle's centre: (radii,
    medians).
    """
    rows, cols = values.shape
    dx = np.arange(cols) - circle.x_px
    dy = np.arange(rows) - circle.y_px
    distance = np.hypot(dx[None, :], dy[:, None])
    near = distance < reach_px
    ring = np.rint(distance[near]).astype(np.intp)
    order = np.argsort(ring, kind="stable")
    ordered = values[near][order]
    first = np.searchsorted(ring[order], np.arange(ring.max(initial=0) + 2))
    pairs = [(r, np.median(ordered[a:b])) for r, (a, b) in enumerate(pairwise(first)) if b - a >= 4]
    table = np.array(pairs, np.float64).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def _find_largest_patch(mask: Mask) -> Mask | None:
    import cv2
    from scipy import ndimage

    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
    filled = np.asarray(ndimage.binary_fill_holes(closed)).astype(np.uint8)
    part = find_largest_part(filled > 0)
    return part if np.count_nonzero(part) >= _PATCH_MIN_PX else None


def _fit_outline_circle(patch: Mask) -> Circle:
    """The circle through the patch's outline, image border left out, robust to dents (algebraic
    fit, reweighted).
    """
    rows, cols = patch.shape
    padded = np.pad(patch, 1, "edge")
    inner = patch & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    y, x = np.nonzero(patch & ~inner)
    if len(x) < 8:
        y, x = np.nonzero(patch)
    design = np.stack([2.0 * x, 2.0 * y, np.ones(len(x))], axis=1)
    target = (x * x + y * y).astype(np.float64)
    weight = np.ones(len(x))
    solution = np.zeros(3)
    for _ in range(20):
        solution = np.linalg.lstsq(design * weight[:, None], target * weight, rcond=None)[0]
        radius = np.sqrt(max(solution[2] + solution[0] ** 2 + solution[1] ** 2, 1.0))
        off = np.abs(np.hypot(x - solution[0], y - solution[1]) - radius)
        weight = 1.0 / np.sqrt(np.maximum(off, 1.0))
    radius = float(np.sqrt(max(solution[2] + solution[0] ** 2 + solution[1] ** 2, 1.0)))
    return Circle(
        x_px=float(solution[0]),
        y_px=float(solution[1]),
        radius_px=min(radius, float(max(rows, cols))),
    )


def fit_sphere(indentation_mm: Floats, contact: Mask, pixel_mm: float) -> tuple[float, float]:
    """Diameter and rms residual in mm by least squares over the contact.

    NaN with too few pixels.
    """
    from scipy import optimize

    if np.count_nonzero(contact) < _CONTACT_PX_MIN:
        return float("nan"), float("nan")
    y, x = (pixel_mm * n for n in np.nonzero(contact))
    z = indentation_mm[contact].astype(np.float64)

    def compute_residuals(p: Doubles) -> Doubles:
        return np.sqrt(np.maximum(p[3] ** 2 - (x - p[0]) ** 2 - (y - p[1]) ** 2, 1e-6)) + p[2] - z

    start = [x.mean(), y.mean(), z.max() - _FIRST_RADIUS_MM, _FIRST_RADIUS_MM]
    found = optimize.least_squares(compute_residuals, start)
    return 2.0 * abs(float(found.x[3])), float(np.sqrt(np.mean(found.fun**2)))
