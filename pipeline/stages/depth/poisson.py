"""Integration of slopes to a surface: the exact least-squares solution by cosine or sine
transforms.

Minimises the sum of |D z - g|^2 over the edges between neighbouring pixels, where the slope of an
edge is the mean of its two pixels, g_{i+1/2} = (g_i + g_{i+1}) / 2. The normal equations are a
five-point Poisson equation, which is diagonal in waves along an axis: cosines at a free end, sines
at an end that is held at zero:

    z^(k, l) = -div^(k, l) / (4 sin^2(pi k / 2W) + 4 sin^2(pi l / 2H)),
    k = 0..W-1 both ends free (DCT-II);  1..W both flat (DST-II);
        1/2..W-1/2 one of each (DCT-IV, DST-IV).

The transform runs along the axis with the faster length; along the other, each wave is a
tridiagonal system, solved by elimination (Hockney 1965): as exact, in a third of the time of
transforms along both.

Frankot & Chellappa 1988, Simchony et al. 1990. Two slips are common in public integrators and are
avoided here: counting k from 1, which damps the long waves, and a divergence without the half of
the central difference.

For slopes with different weights per pixel, `solve_weighted_slopes` minimises sum (D z - g)' A (D z
- g) by conjugate gradients, with this integral as the preconditioner.
"""

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, freeze, median
from pipeline.core.derived import derive_once
from pipeline.core.errors import ShapeError
from pipeline.core.frozen import frozen
from pipeline.core.progress import SILENT, Progress

Boundary = Literal["flat", "free"]
EndConditions = tuple[Boundary, Boundary]

# the longest waves, solved in double precision: single precision loses digits there
_DOUBLE_MODES = 8
_FAST_PRIME_MAX = 13  # lengths without larger prime factors have a fast transform


class SideBoundaries(NamedTuple):
    """The boundary condition along each side of an image."""

    left: Boundary
    right: Boundary
    top: Boundary
    bottom: Boundary


def count_workers(n_pixels: int) -> int:
    """Threads of a transform: a second saves time for large images only."""
    return 2 if n_pixels > 2**18 else 1


def integrate_slopes(
    gx: Floats, gy: Floats, pixel_mm: float, boundary: Boundary | SideBoundaries = "free"
) -> Floats:
    """The surfaces z_mm (..., rows, cols) float32 whose slopes (mm/mm, x right, y down) are nearest
    to gx, gy.

    "free": no condition at the border; "flat": zero along the outer edge of the border pixels; the
    four sides may differ. Free on all sides, the surface has mean zero. Raises ShapeError for
    arrays of different shapes, that are no images or not finite.
    """
    if gx.ndim < 2 or gx.shape != gy.shape or gx.size == 0:
        raise ShapeError(
            f"slopes must be two images of one shape (rows, cols), got {gx.shape} and {gy.shape}"
        )
    sides = (
        boundary
        if isinstance(boundary, SideBoundaries)
        else SideBoundaries(boundary, boundary, boundary, boundary)
    )
    surface = _integrate(gx, gy, pixel_mm, sides)
    # not by `freeze`: a call in another module takes part of so short a time
    surface.flags.writeable = False
    return surface


def _integrate(gx: Floats, gy: Floats, pixel_mm: float, sides: SideBoundaries) -> Floats:
    from pipeline.stages.depth.poisson_kernels import compute_divergence, solve_tridiagonal

    *_, rows, cols = gx.shape
    across = _is_fast_length(cols, rows)
    free = np.array([side == "free" for side in sides])
    out = np.empty((gx.size // (rows * cols), rows, cols), np.float32)
    field = (_require_own(g).reshape(out.shape) for g in (gx, gy))
    if not math.isfinite(compute_divergence(*field, free, out)):
        raise ShapeError("slopes hold values that are not finite; fill them before integrating")
    along_x: EndConditions = (sides.left, sides.right)
    along_y: EndConditions = (sides.top, sides.bottom)
    ends, others = (along_x, along_y) if across else (along_y, along_x)
    wave = out if across else _transpose(out)
    wave = _transform(wave, ends, back=False)
    per, slow = _compute_pivots(wave.shape[1], wave.shape[2], ends, others)
    solve_tridiagonal(wave, per, np.float32(-pixel_mm), slow, np.empty(slow.shape))
    wave = _transform(wave, ends, back=True)
    return (wave if across else _transpose(wave)).reshape(gx.shape)


@frozen
class Integrator:
    """The integral of slopes of one part of an image; it can be cancelled at every use."""

    pixel_mm: float
    sides: SideBoundaries
    # pixels of the part where the median of a surface is 0; without any, its minimum is; None: as
    # it is integrated
    level_at: NDArray[np.intp] | None = None
    progress: Progress = SILENT
    fraction: float = 0.0  # of the work that is done by then

    def __call__(self, gx: Floats, gy: Floats) -> Floats:
        """The surfaces (..., rows, cols) in mm of slopes (gx, gy) in mm/mm."""
        return self.level(integrate_slopes(gx, gy, self.pixel_mm, self.sides))

    def level(self, surface_mm: Floats) -> Floats:
        """The surfaces (..., rows, cols), each at its level."""
        self.progress.step(self.fraction, "integrating slopes")
        at = self.level_at
        if at is None:
            return surface_mm
        if not len(at):
            return surface_mm - surface_mm.min(axis=(-2, -1), keepdims=True)
        images = surface_mm.reshape(-1, surface_mm.shape[-2] * surface_mm.shape[-1])
        level = np.array([median(image[at]) for image in images], np.float32)
        return (images - level[:, None]).reshape(surface_mm.shape)


def solve_weighted_slopes(
    surface_mm: Floats,
    target_slopes: tuple[Floats, Floats],
    slope_weights: Floats,
    pixel_mm: float,
    integrate: Integrator,
    steps: int,
) -> Floats:
    """The surfaces (..., rows, cols) whose slopes are nearest to `target_slopes` under per-pixel
    weights.

    slope_weights (3, rows, cols): a matrix (xx, xy, yy) for each pixel. `steps` of conjugate
    gradients from `surface_mm`, preconditioned by the integral with equal weights.
    """
    from pipeline.stages.depth.poisson_kernels import compute_residual, descend

    surface = np.array(surface_mm, np.float32).reshape(-1, *surface_mm.shape[-2:])
    wanted = (_require_own(g).reshape(surface.shape) for g in target_slopes)
    weights = _require_own(slope_weights)
    per_px = np.float32(1.0) / np.float32(pixel_mm)
    slopes, left, along = (np.zeros((2, *surface.shape), np.float32) for _ in range(3))
    way = np.zeros_like(surface)
    energy = np.zeros(len(surface))
    compute_residual(surface, *wanted, weights, per_px, slopes, left)
    for _ in range(steps):
        step = integrate.level(_integrate(left[0], left[1], pixel_mm, integrate.sides))
        if not descend(step, weights, per_px, slopes, way, along, energy, surface, left):
            break
    return surface.reshape(surface_mm.shape)


def _require_own(a: Floats) -> Floats:
    """The array as kernels take it: they are compiled again for one that is read-only."""
    return np.require(a, np.float32, ("C", "W"))


def _transform(images: Floats, ends: EndConditions, *, back: bool) -> Floats:
    """The orthonormal transform along the last axis for its two end conditions, or its inverse.

    The images are overwritten.
    """
    from scipy import fft

    first, last = ends
    kind = 2 if first == last else 4
    transforms = (fft.dct, fft.idct) if first == "free" else (fft.dst, fft.idst)
    workers = count_workers(images.size)
    return np.asarray(
        transforms[back](images, type=kind, norm="ortho", workers=workers, overwrite_x=True),
        np.float32,
    )


def _transpose(images: Floats) -> Floats:
    """The images (n, cols, rows) of (n, rows, cols)."""
    import cv2

    out = np.empty((images.shape[0], images.shape[2], images.shape[1]), np.float32)
    for image, to in zip(images, out, strict=True):
        cv2.transpose(image, dst=to)
    return out


def _is_fast_length(n: int, other: int) -> bool:
    """Whether a transform of length `n` is no slower than one of another length, by their
    largest prime factors.
    """
    return _compute_largest_prime(n) <= max(_compute_largest_prime(other), _FAST_PRIME_MAX)


def _compute_largest_prime(n: int) -> int:
    largest = 1
    k = 2
    while k * k <= n:
        while n % k == 0:
            n = n // k
            largest = k
        k += 1
    return max(n, largest)


@derive_once
def _compute_pivots(
    rows: int, modes: int, ends: EndConditions, others: EndConditions
) -> tuple[Floats, Doubles]:
    """Inverse pivots for `solve_tridiagonal`: images (rows, modes) with `ends` along the rows,
    `others` across.
    """
    from pipeline.stages.depth.poisson_kernels import compute_pivots

    first = 0.5 if ends[0] != ends[1] else float(ends[0] == "flat")
    waves = 4.0 * np.sin((np.arange(modes) + first) * (math.pi / (2 * modes))) ** 2
    out = np.empty((rows, modes), np.float32)
    slow = np.empty((rows, min(_DOUBLE_MODES, modes)))
    compute_pivots(
        waves, *(1.0 if end == "free" else 3.0 for end in others), np.zeros(modes), out, slow
    )
    return freeze(out), freeze(slow)
