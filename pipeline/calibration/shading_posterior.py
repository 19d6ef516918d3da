"""The field of a unit's light that one touch speaks for, beside what is known of units (`near_lamps`).

A touch that is at rest all around tells how its colours' changes stand to each other, for its slopes have to be those
of one surface; but a surface that is deeper, in weaker light, looks the same. How deep it is then follows from how
likely such light is. Both are asked of the same Gaussian: of surfaces of one shape at several depths, the one under
which the colours seen are the likeliest,

    -2 ln p(q) = sum w q^2 + m' P m - b' P'^-1 b + ln det P',     P' = P + sum w f f',   b = P m + sum w f q

with m and P the field that is known beforehand, f what a pixel's light depends on and w its weight.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.base.arrays import Doubles, Floats
from pipeline.calibration.shading_field import (
    N_POSITION_TERMS,
    N_SHADING_TERMS,
    POSITION_DEGREE,
    ShadingFieldPrior,
    SurfaceSamples,
    compute_position_terms,
)

_NOISE = 0.05  # of q: what no smooth field explains
_WORTH = 200.0  # pixels that can be independent: a lens blurs over six, and a touch and its surroundings are 80 wide


def choose_likeliest_surface(before: ShadingFieldPrior, surfaces: Sequence[SurfaceSamples]) -> tuple[int, Doubles]:
    """Which of the surfaces explains its colours best, and the field's coefficients (m,) under it.

    The surfaces show the same pixels and colours, at other depths.
    """
    from threadpoolctl import threadpool_limits

    # Several threads add up in another order, and wait for each other longer than so small a system takes.
    with threadpool_limits(limits=1, user_api="blas"):
        found = [_after(before, surface) for surface in surfaces]
    best = int(np.argmin([unlikely for unlikely, _ in found]))
    return best, found[best][1]


def expand_field(coefficients: Doubles, u: Floats, v: Floats) -> Floats:
    """The field (rows, cols, 3, N_PARTS) of the columns `u` and rows `v`."""
    table = coefficients.reshape(3, N_POSITION_TERMS, N_SHADING_TERMS)
    grid = np.zeros((3, N_SHADING_TERMS, POSITION_DEGREE + 1, POSITION_DEGREE + 1))
    n = range(POSITION_DEGREE + 1)
    for k, (j, i) in enumerate(
        (j, i) for j in n for i in n if i + j <= POSITION_DEGREE
    ):  # as `light_field.places` has it
        grid[:, :, j, i] = table[:, k]
    along_u, along_v = (np.vander(w.astype(np.float64), POSITION_DEGREE + 1, increasing=True) for w in (u, v))
    field = np.einsum("rj,kpji,ci->rckp", along_v, grid, along_u, optimize=True)
    return np.ascontiguousarray(field, np.float32)


def _after(before: ShadingFieldPrior, surface: SurfaceSamples) -> tuple[float, Doubles]:
    """(-2 ln of how likely the colours are, up to a constant; the field's coefficients after them)."""
    weight = _WORTH / max(len(surface.u), 1) / _NOISE**2
    at = compute_position_terms(surface.u, surface.v)
    features = (at[:, :, None] * surface.shading_terms[:, None, :]).reshape(len(at), -1)
    pull = before.precision @ before.mean
    unlikely = float(before.mean @ pull) + weight * float((surface.change.astype(np.float64) ** 2).sum())
    precision, right = before.precision.copy(), pull.copy()
    block = features.shape[1]
    normal = weight * (features.T @ features)
    for k in range(3):
        mine = slice(k * block, (k + 1) * block)
        precision[mine, mine] += normal
        right[mine] += weight * (features.T @ surface.change[:, k])
    coefficients = np.asarray(np.linalg.solve(precision, right), np.float64)
    return unlikely - float(right @ coefficients) + float(np.linalg.slogdet(precision).logabsdet), coefficients
