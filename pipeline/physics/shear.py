"""Tangential load: motion of a gel's surface and its markers under an object that is dragged along
it.

A layer bonded to a rigid back responds to a tangential traction of wavenumber q, with parts along
the wave (L) and across it (T), with

    U_T(q) = tanh(x) / (G q) T(q),    x = q t,   G = E / 2(1+v)
    U_L(q) = 2 / (E* q) K(x) L(q),    K(x) = ((3-4v) sinh 2x + 2x) / ((3-4v) cosh 2x + 2x^2 + 5 -
                                      12v + 8v^2)

(plane elasticity of the layer, as in Johnson, Contact Mechanics; the tangential counterpart of
`gel`). Both are t / G for long waves. The coupling between pressure and tangential motion is
neglected: it vanishes for an incompressible half-space. The traction moves the contact with the
object and is limited to friction times pressure (Coulomb): the contact slips from its rim inward.
"""

import math
from typing import Any

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Reals, freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import Camera
from pipeline.physics.gel import find_fast_length
from pipeline.physics.lattice import Lattice
from pipeline.sensors.parts import Gel

_CELL_PER_THICKNESS = 0.075  # cell of the solver's grid: the motion is smooth
_PAD = 4.0  # thicknesses: the motion decays with exp(-pi r / 2 t)
_STEPS = 200
_TOLERANCE = 1e-3  # of the largest motion
_LARGEST_X = 40.0
_KPA_TO_N_MM2 = 1e-3


@frozen
class TangentialLoad:
    """Motion of the object along the surface since first contact."""

    displacement_mm: tuple[float, float]  # right and down
    friction: float = 0.8  # largest traction per pressure

    def __post_init__(self) -> None:
        """Raise SettingProblem for values that are not finite or out of range."""
        if not all(math.isfinite(v) for v in self.displacement_mm):
            raise SettingProblem(f"a tangential load must be finite, got {self.displacement_mm}")
        if not 0.0 <= self.friction <= 10.0:
            raise SettingProblem(f"friction must lie between 0 and 10, got {self.friction!r}")


@frozen
class ShearResult:
    """The dragged surface; vectors point right and down."""

    motion_mm: Floats  # (rows, cols, 2) of the material at each pixel
    force_n: tuple[float, float]
    steps: int
    converged: bool


def solve_shear(
    gel: Gel, pixel_mm: float, pressure_kpa: Reals, load: TangentialLoad
) -> ShearResult:
    """The surface under `pressure_kpa` (rows, cols) dragged by `load`.

    Least energy over tractions within the friction limit, by accelerated projected gradients.
    """
    shape = (int(pressure_kpa.shape[0]), int(pressure_kpa.shape[1]))
    cell = (
        max(1, round(_CELL_PER_THICKNESS * gel.thickness_mm / pixel_mm))
        if math.isfinite(gel.thickness_mm)
        else 4
    )
    pressure = _average_cells(pressure_kpa, cell)
    limit = load.friction * pressure
    response = make_response(gel, cell * pixel_mm, (int(pressure.shape[0]), int(pressure.shape[1])))
    traction, steps, converged = _solve_traction(
        response, np.full((*pressure.shape, 2), load.displacement_mm, np.float32), limit
    )
    move = response.compute_motion(traction)
    force = traction.sum(axis=(0, 1), dtype=np.float64) * (cell * pixel_mm) ** 2 * _KPA_TO_N_MM2
    return ShearResult(
        motion_mm=freeze(_interpolate_cells(move, cell, shape)),
        force_n=(float(force[0]), float(force[1])),
        steps=steps,
        converged=converged,
    )


def sample_motion_at_pixels(
    camera: Camera, on: Lattice, move_mm: Floats, depth_mm: Reals
) -> Floats:
    """The motion (rows, cols, 2) in mm at the points that a camera sees at `depth_mm`.

    `move_mm` is (ny, nx, 2).
    """
    import cv2

    ray_x, ray_y = camera.rays()
    col = ((depth_mm * ray_x[None, :] - on.x0_mm) / on.step_mm).astype(np.float32)
    row = ((depth_mm * ray_y[:, None] - on.y0_mm) / on.step_mm).astype(np.float32)
    seen = cv2.remap(move_mm, col, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return freeze(np.asarray(seen, np.float32))


@frozen
class TangentialResponse:
    """The layer's tangential response as a filter over a padded grid."""

    shape: tuple[int, int]
    padded_shape: tuple[int, int]
    transverse_symbol: Doubles  # mm per kPa of each wave, for traction across the wave
    longitudinal_extra: Doubles  # additional motion by traction along the wave, over q^2
    qx: Doubles
    qy: Doubles

    def compute_motion(self, traction_kpa: Floats) -> Floats:
        """Surface motion (rows, cols, 2) in mm under a traction of the same shape."""
        from scipy import fft

        waves: Any = fft.rfft2(traction_kpa, s=self.padded_shape, axes=(0, 1))
        along = self.longitudinal_extra * (self.qx * waves[..., 0] + self.qy * waves[..., 1])
        moved = np.stack(
            [
                self.transverse_symbol * waves[..., 0] + self.qx * along,
                self.transverse_symbol * waves[..., 1] + self.qy * along,
            ]
        )
        back: Any = fft.irfft2(moved, s=self.padded_shape, axes=(1, 2))
        return np.moveaxis(back[:, : self.shape[0], : self.shape[1]], 0, -1).astype(np.float32)


def make_response(gel: Gel, cell_mm: float, shape: tuple[int, int]) -> TangentialResponse:
    """The response of a gel's surface to tractions on `shape` cells of side `cell_mm`."""
    reach = [n - 1 for n in shape]
    if math.isfinite(gel.thickness_mm):
        reach = [min(n, math.ceil(_PAD * gel.thickness_mm / cell_mm)) for n in reach]
    rows, cols = (find_fast_length(n + r) for n, r in zip(shape, reach, strict=True))
    qy = 2 * np.pi * np.fft.fftfreq(rows, cell_mm)[:, None] + np.zeros((1, cols // 2 + 1))
    qx = 2 * np.pi * np.fft.rfftfreq(cols, cell_mm)[None, :] + np.zeros((rows, 1))
    q = np.hypot(qx, qy)
    q[0, 0] = 0.5 * q[0, 1] if math.isinf(gel.thickness_mm) else 1e-3 / gel.thickness_mm
    across, along = compute_symbols(gel, q)
    return TangentialResponse(
        shape=shape,
        padded_shape=(rows, cols),
        transverse_symbol=freeze(across),
        longitudinal_extra=freeze((along - across) / (q * q)),
        qx=freeze(qx),
        qy=freeze(qy),
    )


def compute_symbols(gel: Gel, q_per_mm: Doubles) -> tuple[Doubles, Doubles]:
    """Motion in mm per kPa of traction across and along waves of wavenumber `q_per_mm`, which is
    positive.
    """
    v = gel.poisson
    x = np.minimum(q_per_mm * gel.thickness_mm, _LARGEST_X)
    across = 2.0 * (1 + v) / gel.youngs_kpa / q_per_mm * np.tanh(x)
    k = ((3 - 4 * v) * np.sinh(2 * x) + 2 * x) / (
        (3 - 4 * v) * np.cosh(2 * x) + 2 * x * x + 5 - 12 * v + 8 * v * v
    )
    return across, 2.0 * (1 - v * v) / gel.youngs_kpa / q_per_mm * k


def _solve_traction(
    response: TangentialResponse, target: Floats, limit: Floats
) -> tuple[Floats, int, bool]:
    """(traction, steps, converged): motion equals `target` wherever the traction stays below
    `limit`.
    """
    traction: Floats = np.zeros(target.shape, np.float32)
    largest = float(np.hypot(target[..., 0], target[..., 1])[limit > 0].max(initial=0.0))
    if largest == 0:
        return traction, 0, True
    extra = np.maximum(response.longitudinal_extra * (response.qx**2 + response.qy**2), 0)
    step = np.float32(1.0 / float((response.transverse_symbol + extra).max()))
    ahead = traction
    momentum = 1.0
    for n in range(1, _STEPS + 1):
        new = _limit_traction(ahead + step * (target - response.compute_motion(ahead)), limit)
        change = new - traction
        if float(np.abs(new - ahead).max()) <= _TOLERANCE * float(step) * largest:
            return new, n, True
        if float(np.einsum("ijk,ijk->", ahead - new, change)) > 0:
            momentum = 1.0  # overshoot: restart the acceleration
        grown = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * momentum * momentum))
        ahead = np.add(new, np.float32((momentum - 1.0) / grown) * change, dtype=np.float32)
        traction = new
        momentum = grown
    return traction, _STEPS, False


def _limit_traction(traction: Floats, limit: Floats) -> Floats:
    size = np.maximum(np.hypot(traction[..., 0], traction[..., 1]), 1e-12)
    return (traction * np.minimum(1.0, limit / size)[..., None]).astype(np.float32)


def _average_cells(field: Reals, cell: int) -> Floats:
    rows, cols = (-(-n // cell) for n in field.shape)
    padded = np.zeros((rows * cell, cols * cell), np.float32)
    padded[: field.shape[0], : field.shape[1]] = field
    return padded.reshape(rows, cell, cols, cell).mean(axis=(1, 3))


def _interpolate_cells(field: Floats, cell: int, shape: tuple[int, int]) -> Floats:
    import cv2

    rows, cols = field.shape[:2]
    wide = cv2.resize(field, (cols * cell, rows * cell), interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(wide[: shape[0], : shape[1]], dtype=np.float32)
