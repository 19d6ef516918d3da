"""From slopes back to a surface: the least-squares integral, solved exactly by cosine or sine transforms.

Minimises the sum of |D z - g|^2 over the edges between neighbouring pixels, where the slope of an edge is the mean of
its two pixels, g_{i+1/2} = (g_i + g_{i+1}) / 2. The normal equations are a five-point Poisson equation, which the
DCT-II (nothing known at the border) or the DST-II (zero along the border) makes diagonal:

    z^(k, l) = -div^(k, l) / (4 sin^2(pi k / 2W) + 4 sin^2(pi l / 2H)),   k = 0..W-1 or, for sines, 1..W.

Frankot & Chellappa 1988, Simchony et al. 1990. Two slips are common in public integrators and are avoided here:
counting k from 1, which damps the long waves, and a divergence without the half of the central difference.
"""

from __future__ import annotations

import math
from typing import Literal, get_args

import numpy as np

from pipeline.base.arrays import Floats, freeze
from pipeline.base.errors import SettingProblem, ShapeError
from pipeline.base.memo import remembered

Boundary = Literal["flat", "free"]

_WORKERS = 2


def integrate(gx: Floats, gy: Floats, pixel_mm: float, boundary: Boundary = "free") -> Floats:
    """The surface z_mm (rows, cols) float32 whose slopes (mm/mm, x right, y down) are nearest to gx, gy.

    "free" knows nothing at the border and returns the surface with mean zero; "flat" holds it at zero along the outer
    edge of the border pixels. Raises ShapeError for arrays that differ in shape, are not two-dimensional, or hold a
    value that is not finite, SettingProblem for another boundary.
    """
    from scipy import fft

    if gx.ndim != 2 or gx.shape != gy.shape or gx.size == 0:
        raise ShapeError(f"slopes must be two images of one shape (rows, cols), got {gx.shape} and {gy.shape}")
    if boundary not in get_args(Boundary):
        raise SettingProblem(f"boundary must be one of {', '.join(get_args(Boundary))}, got {boundary!r}")
    if not (math.isfinite(float(gx.sum(dtype=np.float64))) and math.isfinite(float(gy.sum(dtype=np.float64)))):
        raise ShapeError("slopes hold values that are not finite; fill them before integrating")
    rows, cols = gx.shape
    scale = _inverse_eigenvalues(rows, cols, boundary)
    if boundary == "free":
        wave = np.asarray(fft.dctn(_divergence_free(gx, gy), type=2, norm="ortho", workers=_WORKERS))
        z = np.asarray(fft.idctn(wave * scale, type=2, norm="ortho", workers=_WORKERS), np.float32)
    else:
        wave = np.asarray(fft.dstn(_divergence_flat(gx, gy), type=2, norm="ortho", workers=_WORKERS))
        z = np.asarray(fft.idstn(wave * scale, type=2, norm="ortho", workers=_WORKERS), np.float32)
    return freeze(z * np.float32(pixel_mm))


@remembered(16)
def _inverse_eigenvalues(rows: int, cols: int, boundary: Boundary) -> Floats:
    """-1 / eigenvalue of the five-point Laplacian (rows, cols); the constant has none and is left at zero."""
    first = 0 if boundary == "free" else 1
    ky, kx = (np.arange(first, n + first) * (math.pi / (2 * n)) for n in (rows, cols))
    total = 4.0 * np.sin(ky)[:, None] ** 2 + 4.0 * np.sin(kx)[None, :] ** 2
    inverse = np.divide(-1.0, total, out=np.zeros_like(total), where=total > 0)
    return freeze(inverse.astype(np.float32))


def _divergence_free(gx: Floats, gy: Floats) -> Floats:
    """Edge slopes in minus out, edges across the border left out: the transpose of D applied to them, negated."""
    div = np.zeros(gx.shape, dtype=np.float32)
    if gx.shape[1] > 1:
        np.subtract(gx[:, 2:], gx[:, :-2], out=div[:, 1:-1])
        np.add(gx[:, 0], gx[:, 1], out=div[:, 0])
        np.subtract(-gx[:, -2], gx[:, -1], out=div[:, -1])
    if gy.shape[0] > 1:
        div[1:-1] += gy[2:]
        div[1:-1] -= gy[:-2]
        div[0] += gy[0] + gy[1]
        div[-1] -= gy[-2] + gy[-1]
    div *= np.float32(0.5)
    return div


def _divergence_flat(gx: Floats, gy: Floats) -> Floats:
    """As above, with the level border half a pixel outside: the edge to it has the slope of the border pixel itself."""
    div = np.zeros(gx.shape, dtype=np.float32)
    if gx.shape[1] > 1:
        np.subtract(gx[:, 2:], gx[:, :-2], out=div[:, 1:-1])
        np.subtract(gx[:, 1], gx[:, 0], out=div[:, 0])
        np.subtract(gx[:, -1], gx[:, -2], out=div[:, -1])
    if gy.shape[0] > 1:
        div[1:-1] += gy[2:]
        div[1:-1] -= gy[:-2]
        div[0] += gy[1] - gy[0]
        div[-1] += gy[-1] - gy[-2]
    div *= np.float32(0.5)
    return div
