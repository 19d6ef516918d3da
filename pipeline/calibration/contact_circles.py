"""The contact circle of a ball from the colour change alone, and the sphere nearest to its
measured surface.
"""

import math

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Mask
from pipeline.core.frozen import frozen

_NOISE_FACTOR = 6.0  # times the median change of the image: certainly touched
_SHARE_OF_PEAK = 0.35
_PATCH_MIN_PX = 60  # smallest area of a ball
# of a sphere that is fitted
_CONTACT_PX_MIN = 20
_FIRST_RADIUS_MM = 4.0


@frozen
class Circle:
    """A circle in the image."""

    x_px: float
    y_px: float
    radius_px: float


def detect_contact_circle(change: Floats) -> Circle | None:
    """A first circle from a colour change (rows, cols, 3): as large as the changed patch, about its
    centre. None without a clear patch.
    """
    import cv2

    strength = np.linalg.norm(np.asarray(cv2.GaussianBlur(change, (0, 0), 2.0)), axis=2)
    limit = max(
        _NOISE_FACTOR * float(np.median(strength)),
        _SHARE_OF_PEAK * float(np.percentile(strength, 99.8)),
    )
    strong = (strength > limit).astype(np.uint8)
    closed = cv2.morphologyEx(strong, cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
    patch = find_largest_part(closed > 0)
    if np.count_nonzero(patch) < _PATCH_MIN_PX:
        return None
    # The middle of a ball, which is level, may not change.
    around = cv2.moments(cv2.convexHull(np.argwhere(patch)[:, None, ::-1].astype(np.int32)))
    area = around["m00"]
    return Circle(
        x_px=around["m10"] / area, y_px=around["m01"] / area, radius_px=math.sqrt(area / math.pi)
    )


def find_largest_part(mask: Mask) -> Mask:
    """The largest connected part of a mask (rows, cols), empty where the mask is."""
    import cv2

    n, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    return labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])) if n > 1 else mask


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
