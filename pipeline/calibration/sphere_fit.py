"""The sphere nearest to a measured surface in its contact."""

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Mask

_CONTACT_PX_MIN = 20
_FIRST_RADIUS_MM = 4.0


def fit_sphere(indentation_mm: Floats, contact: Mask, pixel_mm: float) -> tuple[float, float]:
    """Diameter and rms residual in mm by least squares over the contact; NaN with too few pixels."""
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
