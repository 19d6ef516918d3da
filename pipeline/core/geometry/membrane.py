"""The rest surface of a sensor: its gel or membrane without contact.

A height field over the sensor's x-y plane, z_mm = h(x_mm, y_mm), covers flat pads and domes, and
makes the paper's test SDF(p, M_target) <= 0 exact in sign: a point nearer to the camera than the
surface has pushed it in.
"""

import numpy as np
from numpy.typing import ArrayLike

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import CalibrationError
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import Camera

REST_DEPTH_TOLERANCE_MM = 1e-9  # far below the float32 rounding of a depth image
_MAX_ITERATIONS = 60


@frozen
class Membrane:
    """Height z of the rest surface on a square grid of `step_mm`, bilinear, level beyond its
    border.
    """

    x0_mm: float  # grid column 0
    y0_mm: float  # grid row 0
    step_mm: float
    z_mm: Doubles  # (ny, nx), sensor frame

    def depth_at(self, x_mm: ArrayLike, y_mm: ArrayLike) -> Doubles:
        """Return z of the rest surface at (x, y), same shape as the input."""
        return self._sample(x_mm, y_mm)[0]

    def signed_distance_mm(self, points_mm: ArrayLike) -> Doubles:
        """Return the distance of points (..., 3) to the rest surface, negative on the camera's side
        (pushed in).

        First-order distance (z - h) / sqrt(1 + |grad h|^2): the sign is exact, the size good near
        the surface.
        """
        p = np.asarray(points_mm, dtype=np.float64)
        h, hx, hy = self._sample(p[..., 0], p[..., 1])
        return np.asarray((p[..., 2] - h) / np.sqrt(1.0 + hx * hx + hy * hy))

    def rest_depth_mm(self, camera: Camera) -> Doubles:
        """Return z (rows, cols) where each pixel's ray meets the rest surface.

        Newton on f(z) = h(x z, y z) - z along the ray; raises CalibrationError if a ray never meets
        the surface.
        """
        rx, ry = (
            a for a in np.broadcast_arrays(camera.rays()[0][None, :], camera.rays()[1][:, None])
        )
        z = np.full(camera.shape, float(self.z_mm.mean()))
        for _ in range(_MAX_ITERATIONS):
            h, hx, hy = self._sample(rx * z, ry * z)
            step = (h - z) / np.minimum(hx * rx + hy * ry - 1.0, -0.1)
            z = z - step
            if np.abs(step).max() < REST_DEPTH_TOLERANCE_MM:
                return freeze(z)
        # Newton can hop between two bilinear cells across a crease; the error is far below a
        # micrometre.
        if np.abs(self._sample(rx * z, ry * z)[0] - z).max() < 1e-6:
            return freeze(z)
        raise CalibrationError(
            "some camera rays do not meet the sensor's rest surface; check [rest] and [camera] of "
            "its description"
        )

    def _sample(self, x_mm: ArrayLike, y_mm: ArrayLike) -> tuple[Doubles, Doubles, Doubles]:
        """Return (h, dh/dx, dh/dy): bilinear, clamped to the grid."""
        ny, nx = self.z_mm.shape
        u = np.clip((np.asarray(x_mm, dtype=np.float64) - self.x0_mm) / self.step_mm, 0.0, nx - 1.0)
        v = np.clip((np.asarray(y_mm, dtype=np.float64) - self.y0_mm) / self.step_mm, 0.0, ny - 1.0)
        i = np.minimum(np.nan_to_num(u).astype(np.intp), nx - 2)
        j = np.minimum(np.nan_to_num(v).astype(np.intp), ny - 2)
        a = u - i
        b = v - j
        # a flat index is twice as fast as a pair
        z = self.z_mm.ravel()
        first = j * nx + i
        z00 = z[first]
        z01 = z[first + 1]
        z10 = z[first + nx]
        z11 = z[first + nx + 1]
        h = (z00 * (1 - a) + z01 * a) * (1 - b) + (z10 * (1 - a) + z11 * a) * b
        hx = ((z01 - z00) * (1 - b) + (z11 - z10) * b) / self.step_mm
        hy = ((z10 - z00) * (1 - a) + (z11 - z01) * a) / self.step_mm
        return h, hx, hy


def make_flat_membrane(z_mm: float, half_width_mm: float, half_height_mm: float) -> Membrane:
    """Return a level pad at distance `z_mm` from the camera."""
    step = max(half_width_mm, half_height_mm) / 8.0
    nx = int(np.ceil(2 * half_width_mm / step)) + 1
    ny = int(np.ceil(2 * half_height_mm / step)) + 1
    return Membrane(
        x0_mm=-half_width_mm,
        y0_mm=-half_height_mm,
        step_mm=step,
        z_mm=freeze(np.full((ny, nx), float(z_mm))),
    )


def make_dome_membrane(
    rim_z_mm: float,
    height_mm: float,
    half_width_mm: float,
    half_height_mm: float,
    step_mm: float = 0.5,
) -> Membrane:
    """Return an inflated membrane over an elliptic rim, its apex farthest from the camera.

    h = rim + height (1 - (x/a)^2 - (y/b)^2) solves T lap h = -p exactly on the ellipse, so it is
    the rest shape of a pre-stretched membrane under pressure; outside the rim it is level.
    """
    nx, ny = (2 * int(np.ceil(a / step_mm)) + 1 for a in (half_width_mm, half_height_mm))
    x = (np.arange(nx) - nx // 2) * step_mm
    y = (np.arange(ny) - ny // 2) * step_mm
    bulge = 1.0 - (x[None, :] / half_width_mm) ** 2 - (y[:, None] / half_height_mm) ** 2
    return Membrane(
        x0_mm=float(x[0]),
        y0_mm=float(y[0]),
        step_mm=step_mm,
        z_mm=freeze(rim_z_mm + height_mm * np.maximum(bulge, 0.0)),
    )
