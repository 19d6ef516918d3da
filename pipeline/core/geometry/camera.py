"""The pinhole camera: x right, y down, z out along the optical axis (OpenCV).

Pixel centres are at integer coordinates: pixel (row, col) is the point (x_px=col, y_px=row).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.core.arrays import Doubles, Mask, Reals
from pipeline.core.errors import CalibrationError
from pipeline.core.frozen import frozen

# image side over focal length, 157 degrees; a lens's focal length in mm exceeds it
WIDEST_VIEW = 10.0
MOST_FOCAL_PX = 1e5  # a pixel covers 0.01 mm at a metre
MOST_OFFSET = 4.0  # image sides from the middle of a cropped image to the optical axis
MIN_DEPTH_MM = 1e-3  # points nearer to the lens plane have no image
# bounds of focal lengths, and of those and the principal point; float32 holds what follows
_SHORTEST_PX = 1e-3
_FARTHEST_PX = 1e9


@frozen
class Camera:
    """Intrinsics K of an image of `rows` x `cols` pixels.

    No lens distortion (files are rectified where read).
    """

    rows: int
    cols: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float

    def __post_init__(self) -> None:
        """Raise CalibrationError for intrinsics without an inverse."""
        values = (self.fx_px, self.fy_px, self.cx_px, self.cy_px)
        if not all(map(math.isfinite, values)):
            raise CalibrationError(f"camera intrinsics must be finite, got {values}")
        if not (self.fx_px > 0 and self.fy_px > 0):
            raise CalibrationError(
                f"the camera matrix is singular: focal lengths {self.fx_px:g} and {self.fy_px:g} "
                "px must be positive"
            )
        if not (min(values[:2]) >= _SHORTEST_PX and max(map(abs, values)) <= _FARTHEST_PX):
            raise CalibrationError(
                f"camera intrinsics of {values} px cannot be right; check their unit and that the "
                "file is whole"
            )
        if self.rows < 1 or self.cols < 1:
            raise CalibrationError(
                f"a camera image needs at least one pixel, got {self.rows} x {self.cols}"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Return (rows, cols)."""
        return self.rows, self.cols

    @property
    def matrix(self) -> Doubles:
        """Return K (3, 3)."""
        return np.array(
            [[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]]
        )

    def rays(self) -> tuple[Doubles, Doubles]:
        """Return x/z of every column (cols,) and y/z of every row (rows,): K^-1 (u, v, 1)."""
        x = (np.arange(self.cols, dtype=np.float64) - self.cx_px) / self.fx_px
        y = (np.arange(self.rows, dtype=np.float64) - self.cy_px) / self.fy_px
        return x, y

    def back_project(self, depth_mm: Reals) -> Doubles:
        """Return the points (rows, cols, 3) of a depth image in the sensor frame; NaN stays NaN."""
        z = np.asarray(depth_mm, dtype=np.float64)
        return self.back_project_at(np.arange(self.cols), np.arange(self.rows)[:, None], z)

    def back_project_at(self, x_px: NDArray[Any], y_px: NDArray[Any], z_mm: Doubles) -> Doubles:
        """Return the points (..., 3) in the sensor frame of depths (...) at image positions."""
        return np.stack(
            [
                (x_px - self.cx_px) / self.fx_px * z_mm,
                (y_px - self.cy_px) / self.fy_px * z_mm,
                z_mm,
            ],
            axis=-1,
        )

    def project(self, points_mm: ArrayLike) -> tuple[Doubles, Doubles, Mask]:
        """Return (x_px, y_px, visible) of points (n, 3).

        Points behind the lens or outside the image are invisible.
        """
        p = np.asarray(points_mm, dtype=np.float64)
        in_front = p[..., 2] > MIN_DEPTH_MM
        z = np.where(in_front, p[..., 2], 1.0)
        x_px = self.fx_px * p[..., 0] / z + self.cx_px
        y_px = self.fy_px * p[..., 1] / z + self.cy_px
        inside = (
            (x_px >= -0.5) & (x_px < self.cols - 0.5) & (y_px >= -0.5) & (y_px < self.rows - 0.5)
        )
        return x_px, y_px, in_front & inside

    def scale(self, factor: float) -> Camera:
        """Return the same view with `factor` times as many pixels along each side, pixel areas
        aligned.
        """
        return self.resize(max(1, round(self.rows * factor)), max(1, round(self.cols * factor)))

    def resize(self, rows: int, cols: int) -> Camera:
        """Return the same view in `rows` x `cols` pixels, pixel areas aligned."""
        sy = rows / self.rows
        sx = cols / self.cols
        return Camera(
            rows=rows,
            cols=cols,
            fx_px=self.fx_px * sx,
            fy_px=self.fy_px * sy,
            cx_px=(self.cx_px + 0.5) * sx - 0.5,
            cy_px=(self.cy_px + 0.5) * sy - 0.5,
        )

    def crop(self, top: int, left: int, rows: int, cols: int) -> Camera:
        """Return the window of `rows` x `cols` pixels whose first pixel is (top, left)."""
        return replace(self, rows=rows, cols=cols, cx_px=self.cx_px - left, cy_px=self.cy_px - top)


def make_camera(k: ArrayLike, rows: int, cols: int, what: str = "the camera matrix K") -> Camera:
    """Return the camera of K (3, 3).

    Raises CalibrationError when K is singular, skewed or not finite.
    """
    m = np.asarray(k, dtype=np.float64)
    if m.shape != (3, 3):
        raise CalibrationError(f"{what} must be 3x3, got shape {m.shape}")
    if not np.isfinite(m).all():
        raise CalibrationError(f"{what} holds a value that is not finite")
    if m[2, 2] == 0 or m[0, 0] == 0 or m[1, 1] == 0:
        raise CalibrationError(f"{what} is singular: its diagonal is {np.diag(m).tolist()}")
    m = m / m[2, 2]
    if abs(m[0, 1]) > 1e-6 * abs(m[0, 0]) or np.abs(m[[1, 2, 2], [0, 0, 1]]).max() > 0:
        raise CalibrationError(f"{what} must be upper triangular without skew, got {m.tolist()}")
    camera = Camera(
        rows=rows, cols=cols, fx_px=m[0, 0], fy_px=m[1, 1], cx_px=m[0, 2], cy_px=m[1, 2]
    )
    least_px = max(rows, cols) / WIDEST_VIEW
    sides_px = np.array([cols, rows])
    is_lens = (
        least_px <= min(camera.fx_px, camera.fy_px)
        and max(camera.fx_px, camera.fy_px) <= MOST_FOCAL_PX
    )
    if not is_lens or (np.abs(m[:2, 2] - sides_px / 2) > MOST_OFFSET * sides_px).any():
        raise CalibrationError(
            f"{what} cannot be that of an image of {cols} x {rows} px: focal lengths lie within "
            f"{least_px:.3g} and "
            f"{MOST_FOCAL_PX:.0e} px and the axis near the image, got {m[:2].tolist()}; check its "
            "unit and order"
        )
    return camera
