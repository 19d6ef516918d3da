"""Elastic response of a gel pad: displacement of its surface under a pressure, as an FFT
convolution.

A layer bonded to a rigid back responds to a pressure of wavenumber q with (K. L. Johnson, Contact
Mechanics, 1985)

    U(q) = 2 / (E* q) K(q t) P(q),   K(x) = ((3-4v) sinh 2x - 2x) / ((3-4v) cosh 2x + 2x^2 + 5 - 12v
                                     + 8v^2)

An infinite thickness is a half-space, whose response to a pixel is Love's.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.core.arrays import Doubles, Floats, freeze
from pipeline.core.derived import derive_once
from pipeline.sensors.parts import Gel

_LARGEST_X = 40.0  # K is 1 to double precision long before sinh overflows
# thicknesses: the kernel of a nearly incompressible layer is below 1e-4 of its peak there
_REACH = 8.0
_MIN_PX_FOR_THREADS = 2**15  # threads take longer to start than to work on fewer pixels
_REACH_MAX_PX = 1024  # larger than any image; bounds the table of a very thick pad


@dataclass(frozen=True, slots=True, kw_only=True)
class ElasticLayer:
    """Elastic response of the pad as a convolution over a zero-padded grid: exact, without
    wrap-around.
    """

    padded_shape: tuple[int, int]
    periodic_shape: tuple[int, int]  # grid of the preconditioner, which may wrap around
    symbol: Doubles | Floats  # mm per kPa of each wave
    inverse_symbol: Floats  # kPa per mm of each wave, always positive

    def compute_displacement(self, pressure_kpa: Floats) -> Floats:
        """Surface displacement (rows, cols) in mm under a pressure (rows, cols)."""
        return _convolve(pressure_kpa, self.symbol, self.padded_shape)

    def compute_pressure(self, displacement_mm: Floats) -> Floats:
        """Pressure (rows, cols) in kPa that makes the displacement on a periodic pad: the
        preconditioner.
        """
        return _convolve(displacement_mm, self.inverse_symbol, self.periodic_shape)


@derive_once
def make_elastic_layer(gel: Gel, pixel_mm: float, shape: tuple[int, int]) -> ElasticLayer:
    """The pad's response over a grid of `shape`, cached."""
    # Pixels interact over n - 1 steps, in a thin layer at most over the reach of its kernel.
    reach = _compute_reach_px(gel, pixel_mm)
    span = tuple(min(n - 1, reach) for n in shape)
    padded = find_fast_length(shape[0] + span[0]), find_fast_length(shape[1] + span[1])
    rows, cols = (np.arange(-n, n + 1) for n in span)
    around = np.zeros(padded)
    around[np.ix_(rows, cols)] = _compute_kernel(gel, pixel_mm, span)
    repeated = find_fast_length(shape[0]), find_fast_length(shape[1])
    inverse = 1.0 / compute_symbol(gel, pixel_mm, repeated)
    return ElasticLayer(
        padded_shape=padded,
        periodic_shape=repeated,
        symbol=freeze(np.fft.rfft2(around).real.astype(np.float32)),  # even in x and y, so real
        inverse_symbol=freeze(inverse.astype(np.float32)),
    )


def _convolve(field: Floats, symbol: Doubles | Floats, padded: tuple[int, int]) -> Floats:
    """A convolution, one axis after the other; padding rows are not transformed along x."""
    from scipy import fft

    rows, cols = field.shape
    workers = 2 if padded[0] * padded[1] > _MIN_PX_FOR_THREADS else 1
    waves: Any = fft.rfft(field, n=padded[1], axis=1, workers=workers)
    waves = fft.fft(waves, n=padded[0], axis=0, workers=workers, overwrite_x=True)
    waves *= symbol
    waves = fft.ifft(waves, axis=0, workers=workers, overwrite_x=True)[:rows]
    back: Any = fft.irfft(waves, n=padded[1], axis=1, workers=workers)
    return np.ascontiguousarray(back[:, :cols])


def find_fast_length(n: int) -> int:
    """The next length with a fast Fourier transform."""
    from scipy import fft

    return int(fft.next_fast_len(n, real=True))  # pyright: ignore[reportArgumentType] (dispatch hides the type)


def _compute_reach_px(gel: Gel, pixel_mm: float) -> int:
    if math.isinf(gel.thickness_mm):
        return 10**6
    return min(math.ceil(_REACH * gel.thickness_mm / pixel_mm), _REACH_MAX_PX)


def _compute_kernel(gel: Gel, pixel_mm: float, span: tuple[int, ...]) -> Doubles:
    """Displacement (2 span + 1 along each axis) in mm around one pixel under 1 kPa."""
    if math.isinf(gel.thickness_mm):
        y, x = (np.arange(-n, n + 1, dtype=np.float64) * pixel_mm for n in span)
        return _compute_half_space_kernel(gel, pixel_mm, x[None, :], y[:, None])
    wide = _compute_layer_kernel(gel, pixel_mm)
    middle = wide.shape[0] // 2
    return wide[middle - span[0] : middle + span[0] + 1, middle - span[1] : middle + span[1] + 1]


@derive_once
def _compute_layer_kernel(gel: Gel, pixel_mm: float) -> Doubles:
    n = 2 * _compute_reach_px(gel, pixel_mm) + 2
    symbol = compute_symbol(gel, pixel_mm, (n, n))
    return freeze(np.fft.fftshift(np.fft.irfft2(symbol, s=(n, n))))


def compute_symbol(gel: Gel, pixel_mm: float, padded: tuple[int, int]) -> Doubles:
    """Displacement in mm by 1 kPa of each wave of a periodic grid, as `np.fft.rfft2` orders
    them.
    """
    v = gel.poisson
    t = gel.thickness_mm
    qy = 2 * np.pi * np.fft.fftfreq(padded[0], pixel_mm)[:, None]
    qx = 2 * np.pi * np.fft.rfftfreq(padded[1], pixel_mm)[None, :]
    q = np.hypot(qx, qy)
    q[0, 0] = 0.5 * q[0, 1]
    x = np.minimum(q * t, _LARGEST_X)
    k = ((3 - 4 * v) * np.sinh(2 * x) - 2 * x) / (
        (3 - 4 * v) * np.cosh(2 * x) + 2 * x * x + 5 - 12 * v + 8 * v * v
    )
    symbol = 2.0 * (1 - v * v) / (gel.youngs_kpa * q) * k
    if math.isfinite(t):
        # An incompressible layer does not move as a whole; a small value keeps the operator
        # definite.
        symbol[0, 0] = max(t * (1 + v) * (1 - 2 * v) / (1 - v), 1e-6 * t) / gel.youngs_kpa
    return symbol


def _compute_half_space_kernel(gel: Gel, pixel_mm: float, x: Doubles, y: Doubles) -> Doubles:
    """Love's displacement of a half-space under a uniform pressure on one pixel (Boussinesq over
    a square).
    """
    h = pixel_mm / 2

    def integrate_corner(cx: Doubles, cy: Doubles) -> Doubles:
        return cx * np.arcsinh(cy / np.abs(cx)) + cy * np.arcsinh(cx / np.abs(cy))

    square = (
        integrate_corner(x + h, y + h)
        + integrate_corner(x - h, y - h)
        - integrate_corner(x + h, y - h)
        - integrate_corner(x - h, y + h)
    )
    return square * (1 - gel.poisson**2) / (np.pi * gel.youngs_kpa)
