"""Contact of a gel pad: an elastic layer bonded to a rigid back, without friction and adhesion.

Contact is the complementarity problem p >= 0, u >= overlap, p (u - overlap) = 0 with
the layer's response, solved by the constrained conjugate gradients of Polonsky and Keer (1999),
preconditioned with the inverse of the periodic layer: a few steps of two or three FFT convolutions,
instead of about twenty.

Elastic response of a gel pad: displacement of its surface under a pressure, as an FFT
convolution.

A layer bonded to a rigid back responds to a pressure of wavenumber q with (K. L. Johnson, Contact
Mechanics, 1985)

    U(q) = 2 / (E* q) K(q t) P(q),   K(x) = ((3-4v) sinh 2x - 2x) / ((3-4v) cosh 2x + 2x^2 + 5 - 12v
                                     + 8v^2)

An infinite thickness is a half-space, whose response to a pixel is Love's.
"""

import math
from collections.abc import Callable, Generator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.core.frozen import frozen
from pipeline.sensors.parts import Gel

_LARGEST_X = 40.0  # K is 1 to double precision long before sinh overflows
# thicknesses: the kernel of a nearly incompressible layer is below 1e-4 of its peak there
_REACH = 8.0
_MIN_PX_FOR_THREADS = 2**15  # threads take longer to start than to work on fewer pixels
_REACH_MAX_PX = 1024  # larger than any image; bounds the table of a very thick pad


@frozen
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

    # dispatch hides the type
    return int(fft.next_fast_len(n, real=True))  # pyright: ignore[reportArgumentType]


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


TOLERANCE_MM = 1e-4  # 0.1 um: far below the resolution of any camera
MAX_STEPS = 400
_NOTHING_MM = 1e-9  # smaller overlaps are zero: denormal numbers make every sum three times as slow
_KPA_TO_N_MM2 = 1e-3
_BOX_PX = 32  # sides of the solved box are multiples of this
# share of the deepest overlap by which the gel may bulge: such gaps may come into contact
_BULGE = 0.3


@frozen
class GelContact:
    """State of the pressed gel; arrays (rows, cols)."""

    indentation_mm: Floats  # u: towards the camera; negative where the gel bulges out
    contact: Mask  # pressure > 0
    pressure_kpa: Floats
    force_n: float
    steps: int
    residual_mm: float  # largest overlap left, or gap under a pressure
    converged: bool


def press_gel(
    gel: Gel,
    pixel_mm: float,
    overlap_mm: NDArray[np.floating],
    *,
    tolerance_mm: float = TOLERANCE_MM,
    max_steps: int = MAX_STEPS,
) -> GelContact:
    """The gel under a rigid object that reaches `overlap_mm` (rows, cols) past its rest surface.

    Where the overlap is not finite there is no object; where it is negative the object is above the
    rest surface.
    """
    overlap = _clean_overlap(overlap_mm)
    deepest = float(overlap.max(initial=-np.inf))
    if deepest <= 0:
        return _no_contact(overlap.shape, pixel_mm)
    box = _bound_mask(overlap > -_BULGE * deepest)
    while True:
        pressure, steps, residual = _solve_contact(
            gel, pixel_mm, overlap[box], tolerance_mm, max_steps
        )
        whole = np.zeros(overlap.shape, np.float32)
        whole[box] = pressure
        u = make_elastic_layer(gel, pixel_mm, overlap.shape).compute_displacement(whole)
        everywhere = (slice(0, overlap.shape[0]), slice(0, overlap.shape[1]))
        if box == everywhere or float((overlap - u).max()) <= max(2 * residual, tolerance_mm):
            return _result(u, whole, pixel_mm, steps, residual, residual <= tolerance_mm)
        box = everywhere  # the bulge touches the object outside the box


def relax_gel(
    gel: Gel,
    pixel_mm: float,
    prescribed_mm: NDArray[np.floating],
    mask: Mask,
    *,
    tolerance_mm: float = TOLERANCE_MM,
    max_steps: int = MAX_STEPS,
) -> GelContact:
    """The surface of least elastic energy that equals `prescribed_mm` on `mask`.

    Pressures may be negative.

    Conjugate gradients on the masked operator, preconditioned with the inverse of the unmasked one.
    """
    target = _clean_overlap(np.where(mask, prescribed_mm, 0.0))
    if not mask.any():
        return _no_contact(target.shape, pixel_mm)
    box = _bound_mask(mask)
    layer = make_elastic_layer(gel, pixel_mm, target[box].shape)
    inside = mask[box]
    pressure = np.zeros(inside.shape, np.float32)
    left = target[box].copy()
    steps = 0
    for steps, step in enumerate(
        generate_steps(
            left,
            lambda p: layer.compute_displacement(p) * inside,
            lambda u: layer.compute_pressure(u) * inside,
        ),
        1,
    ):
        pressure += step
        if float(np.abs(left).max()) <= tolerance_mm or steps == max_steps:
            break
    worst = float(np.abs(left).max())
    whole = np.zeros(target.shape, np.float32)
    whole[box] = pressure
    u = make_elastic_layer(gel, pixel_mm, target.shape).compute_displacement(whole)
    return _result(u, whole, pixel_mm, steps, worst, worst <= tolerance_mm)


def _solve_contact(
    gel: Gel, pixel_mm: float, overlap: Floats, tolerance_mm: float, max_steps: int
) -> tuple[Floats, int, float]:
    """(pressure, steps, residual in mm) on the box of `overlap`."""
    layer = make_elastic_layer(gel, pixel_mm, overlap.shape)
    stiffness = np.float32(1.0) / np.float32(
        layer.compute_displacement(np.ones(overlap.shape, np.float32)).max()
    )
    pressure = np.maximum(overlap, 0) * stiffness
    u = layer.compute_displacement(pressure)
    direction = np.zeros_like(pressure)
    norm = 1.0
    conjugate = False
    residual = np.inf
    for step in range(max_steps):
        gap = u - overlap
        touching = pressure > 0
        residual = max(float(np.abs(gap[touching]).max(initial=0.0)), float(-gap.min()))
        if residual <= tolerance_mm:
            return pressure, step, residual
        along = np.where(touching, gap, np.float32(0))
        steep = np.where(touching, layer.compute_pressure(along), np.float32(0))
        new_norm = compute_dot(along, steep)
        direction = steep + np.float32(new_norm / norm if conjugate else 0.0) * np.where(
            touching, direction, np.float32(0)
        )
        norm = new_norm
        moved = layer.compute_displacement(direction)
        curvature = compute_dot(direction, moved)
        if curvature <= 0:  # no contact yet: push where it overlaps
            pressure = np.where(gap < 0, -stiffness * gap, pressure)
            u = layer.compute_displacement(pressure)
            conjugate = False
            continue
        length = np.float32(compute_dot(along, direction) / curvature)
        trial = pressure - length * direction
        clipped = trial < 0
        entering = ~touching & (gap < 0)
        conjugate = not entering.any()
        if conjugate and not clipped.any():
            pressure = trial
            u = u - length * moved
            if step % 20 == 19:
                # remove the rounding errors of the recursion
                u = layer.compute_displacement(pressure)
            continue
        trial[clipped] = 0
        trial[entering] -= stiffness * gap[entering]
        pressure = trial
        u = layer.compute_displacement(pressure)
    return pressure, max_steps, residual


def _clean_overlap(overlap_mm: NDArray[np.floating]) -> Floats:
    """The overlap in single precision, far below the surface where it is not finite."""
    overlap = np.asarray(overlap_mm, dtype=np.float32)
    overlap = np.where(np.isfinite(overlap), overlap, np.float32(-1e6))
    overlap[np.abs(overlap) < _NOTHING_MM] = 0.0
    return overlap


def _bound_mask(mask: Mask) -> tuple[slice, slice]:
    """The box of a mask, its sides rounded up so that cached tables serve many boxes."""
    rows = np.flatnonzero(mask.any(axis=1))
    cols = np.flatnonzero(mask.any(axis=0))

    def bound_axis(indices: NDArray[np.intp], n: int) -> slice:
        low = int(indices[0])
        high = int(indices[-1]) + 1
        size = min(n, -(-(high - low) // _BOX_PX) * _BOX_PX)
        start = min(low, n - size)
        return slice(start, start + size)

    return bound_axis(rows, mask.shape[0]), bound_axis(cols, mask.shape[1])


def _no_contact(shape: tuple[int, ...], pixel_mm: float) -> GelContact:
    return _result(
        np.zeros(shape, np.float32), np.zeros(shape, np.float32), pixel_mm, 0, 0.0, converged=True
    )


def _result(
    u: Floats, pressure: Floats, pixel_mm: float, steps: int, residual_mm: float, converged: bool
) -> GelContact:
    return GelContact(
        indentation_mm=freeze(u),
        contact=freeze(pressure > 0),
        pressure_kpa=freeze(pressure),
        force_n=float(pressure.sum(dtype=np.float64)) * pixel_mm**2 * _KPA_TO_N_MM2,
        steps=steps,
        residual_mm=residual_mm,
        converged=converged,
    )


def generate_steps(
    residual: Floats, apply: Callable[[Floats], Floats], precondition: Callable[[Floats], Floats]
) -> Generator[Floats]:
    """Yield the conjugate gradient steps whose sum solves A x = b.

    The caller adds them up and stops.

    The flexible form (Notay 2000): a direction is made orthogonal to the last by A itself, so that
    the preconditioner may be unsymmetric or inexact.

    `residual` is b at first, and b - A x in place after each step. `apply` is x -> A x, symmetric
    and positive on the directions that `precondition` gives. Both may return buffers of their own:
    a step is valid until the next one, and no array is allocated in it. Ends where no step reduces
    the residual any more.
    """
    direction = np.zeros_like(residual)
    moved = np.zeros_like(residual)
    reduced = 1.0
    while True:
        guided = precondition(residual)
        direction *= -compute_dot(guided, moved) / reduced
        direction += guided
        moved = apply(direction)
        reduced = compute_dot(direction, residual)
        curvature = compute_dot(direction, moved)
        if not (reduced > 0.0 and curvature > 0.0):
            return
        moved *= reduced / curvature
        residual -= moved
        np.multiply(direction, reduced / curvature, out=guided)
        yield guided


def compute_dot(a: Floats, b: Floats) -> float:
    """The dot product of two fields in double precision and in a fixed order.

    BLAS distributes it over threads.
    """
    return float(np.einsum("i,i->", a.ravel(), b.ravel(), dtype=np.float64))
