"""From slopes back to a surface: the least-squares integral, solved exactly by cosine and sine transforms.

Minimises the sum of |D z - g|^2 over the edges between neighbouring pixels, where the slope of an edge is the mean of
its two pixels, g_{i+1/2} = (g_i + g_{i+1}) / 2. The normal equations are a five-point Poisson equation, which waves
along each axis make diagonal, cosines at an end where nothing is known, sines at one that is held at zero:

    z^(k, l) = -div^(k, l) / (4 sin^2(pi k / 2W) + 4 sin^2(pi l / 2H)),
    k = 0..W-1 both ends free (DCT-II);  1..W both flat (DST-II);  1/2..W-1/2 one of each (DCT-IV, DST-IV).

Frankot & Chellappa 1988, Simchony et al. 1990. Two slips are common in public integrators and are avoided here:
counting k from 1, which damps the long waves, and a divergence without the half of the central difference.

Where slopes are known more surely at some pixels than at others, `nearest` asks for the surface that minimises
sum (D z - g)' A (D z - g), of which no transform is known; a few such integrals lead to it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, NamedTuple, get_args

import numpy as np

from pipeline.base.arrays import Doubles, Floats, freeze
from pipeline.base.errors import SettingProblem, ShapeError
from pipeline.base.memo import remembered
from pipeline.physics.slopes import slopes

Boundary = Literal["flat", "free"]
Integrated = Callable[[Floats, Floats], Floats]  # slopes (gx, gy) in mm/mm to a surface in mm

_WORKERS = 2
_NOTHING = 1e-20


class Sides(NamedTuple):
    """What is known along each side of an image."""

    left: Boundary
    right: Boundary
    top: Boundary
    bottom: Boundary


def integrate(gx: Floats, gy: Floats, pixel_mm: float, boundary: Boundary | Sides = "free") -> Floats:
    """The surfaces z_mm (..., rows, cols) float32 whose slopes (mm/mm, x right, y down) are nearest to gx, gy.

    "free" knows nothing at the border; "flat" holds it at zero along the outer edge of the border pixels; the four
    sides may differ. Free on all of them, the surface has mean zero. Raises ShapeError for arrays that differ in shape,
    are no images, or hold a value that is not finite, SettingProblem for another boundary.
    """
    if gx.ndim < 2 or gx.shape != gy.shape or gx.size == 0:
        raise ShapeError(f"slopes must be two images of one shape (rows, cols), got {gx.shape} and {gy.shape}")
    sides = boundary if isinstance(boundary, Sides) else Sides(boundary, boundary, boundary, boundary)
    for side in sides:
        if side not in get_args(Boundary):
            raise SettingProblem(f"boundary must be one of {', '.join(get_args(Boundary))}, got {side!r}")
    if not (math.isfinite(float(gx.sum(dtype=np.float64))) and math.isfinite(float(gy.sum(dtype=np.float64)))):
        raise ShapeError("slopes hold values that are not finite; fill them before integrating")
    wave = _divergence(gx, gy, sides)
    for axis, ends in ((-1, sides[:2]), (-2, sides[2:])):
        wave = _waves(wave, axis, ends, back=False)
    wave = wave * _inverse_eigenvalues(gx.shape[-2], gx.shape[-1], sides)
    for axis, ends in ((-2, sides[2:]), (-1, sides[:2])):
        wave = _waves(wave, axis, ends, back=True)
    return freeze(np.ascontiguousarray(wave * np.float32(pixel_mm), np.float32))


def nearest(
    surface_mm: Floats, wanted: tuple[Floats, Floats], sure: Floats, pixel_mm: float, integrated: Integrated, steps: int
) -> Floats:
    """The surfaces (..., rows, cols) whose slopes come nearest to those `wanted`, as far as pixels are sure of them.

    sure (rows, cols, 3): the weight of a pixel's two slopes, a matrix (xx, xy, yy). `steps` of conjugate gradients from
    `surface_mm`, helped by `integrated`, the surfaces when all slopes count alike.
    """
    weight = np.ascontiguousarray(np.moveaxis(sure, 2, 0), np.float32)
    surface, slope = np.array(surface_mm, np.float32), np.stack(slopes(surface_mm, pixel_mm))
    left = _weighed(weight, np.stack(wanted) - slope)  # a field, whose divergence is the gradient
    way, along, energy = np.zeros_like(surface), np.zeros_like(left), np.zeros(surface.shape[:-2])
    for k in range(steps):
        step = integrated(left[0], left[1])
        slope = np.stack(slopes(step, pixel_mm))
        new = _dot(left, slope)
        on = _single(_share(new, energy) if k else np.zeros_like(new))
        way = on * way + step
        along = on * along + slope
        pulled = _weighed(weight, along)
        stiff, energy = _dot(along, pulled), new
        far = _single(_share(new, stiff))
        if not far.any():
            break
        surface += far * way
        left -= far * pulled
    return surface


def _weighed(weight: Floats, field: Floats) -> Floats:
    """Matrices (xx, xy, yy) times vectors (2, ..., rows, cols)."""
    (xx, xy, yy), (x, y) = weight, field
    return np.stack([xx * x + xy * y, xy * x + yy * y])


def _dot(a: Floats, b: Floats) -> Doubles:
    """Sums (...) of a b (2, ..., rows, cols), the same however many threads there are."""
    return np.asarray((a * b).sum(axis=(0, -2, -1), dtype=np.float64))


def _share(part: Doubles, whole: Doubles) -> Doubles:
    """`part` of `whole`; 0 where there is nothing."""
    return np.divide(part, whole, out=np.zeros_like(part), where=whole > _NOTHING)


def _single(numbers: Doubles) -> Floats:
    """To be multiplied with images (..., rows, cols)."""
    return numbers.astype(np.float32)[..., None, None]


def _waves(image: Floats, axis: int, ends: tuple[Boundary, ...], *, back: bool) -> Floats:
    """The orthonormal transform along one axis whose waves fit both ends, or back from it."""
    from scipy import fft

    first, last = ends
    kind = 2 if first == last else 4
    transforms = (fft.dct, fft.idct) if first == "free" else (fft.dst, fft.idst)
    return np.asarray(transforms[back](image, type=kind, axis=axis, norm="ortho", workers=_WORKERS), np.float32)


@remembered(8)
def _inverse_eigenvalues(rows: int, cols: int, sides: Sides) -> Floats:
    """-1 / eigenvalue of the five-point Laplacian (rows, cols); the constant has none and is left at zero."""
    first = {("free", "free"): 0.0, ("flat", "flat"): 1.0}
    kx, ky = (
        (np.arange(n) + first.get(ends, 0.5)) * (math.pi / (2 * n))
        for n, ends in ((cols, sides[:2]), (rows, sides[2:]))
    )
    total = 4.0 * np.sin(ky)[:, None] ** 2 + 4.0 * np.sin(kx)[None, :] ** 2
    inverse = np.divide(-1.0, total, out=np.zeros_like(total), where=total > 0)
    return freeze(inverse.astype(np.float32))


def _divergence(gx: Floats, gy: Floats, sides: Sides) -> Floats:
    """Edge slopes in minus out. A flat border lies half a pixel outside: the edge to it has its pixel's own slope.

    The edge across a free border is left out: the divergence is the transpose of D applied to the slopes, negated.
    """
    div = np.zeros(gx.shape, dtype=np.float32)
    for d, g, (first, last) in ((div, gx, sides[:2]), (div.swapaxes(-1, -2), gy.swapaxes(-1, -2), sides[2:])):
        n = g.shape[-1]
        if n > 1:
            d[..., 1:-1] += g[..., 2:]
            d[..., 1:-1] -= g[..., :-2]
            d[..., 0] += g[..., 0] + g[..., 1]
            d[..., -1] -= g[..., -2] + g[..., -1]
        if first == "flat":
            d[..., 0] -= 2.0 * g[..., 0]
        if last == "flat":
            d[..., -1] += 2.0 * g[..., -1]
    div *= np.float32(0.5)
    return div
