"""Slope from colour change: a polynomial in the change and the position, without a constant term.

Without a colour change the slope is exactly zero: an untouched gel is flat. The change is relative
to the reference brightness, so vignetting and fading light cancel to first order:

    q = span * (image - reference) / (blurred reference + offset)                      per colour,
                                                                                       offset, span
                                                                                       in grey
    slope = sum_ab  C_ab  monomial_a(q_r, q_g, q_b)  monomial_b(u, v),     degree of a in 1..m,
                    degree of b in 0..n

u and v run over the image from -1 to 1 along its longer axis. The magnitude of the slope is limited
to `slope_max`, the range of the samples.
"""

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, Mask, freeze
from pipeline.core.frozen import frozen

OFFSET_GREY = 15.0  # limits the amplification of camera noise in dark corners
_RIDGE_GROWTH = 4.0  # factor of the ridge for each further degree
SPAN_GREY = 2.5  # brings q to the order of 1 for steep slopes, so one ridge suits all monomials


@frozen
class SlopeModel:
    """Coefficients of the polynomial and its range."""

    colour_degree: int
    position_degree: int
    # (v powers, u powers, colour monomials, 2), zero where u + v exceed the degree
    coefficients: Floats
    slope_max: float  # mm/mm


@frozen
class SlopeSamples:
    """Pixels with known slopes."""

    change: Floats  # (n, 3) q of the formula above
    u: Floats  # (n,)
    v: Floats  # (n,)
    slopes: Floats  # (n, 2) mm/mm


def compute_positions(shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """U of every column (cols,) and v of every row (rows,)."""
    rows, cols = shape
    return locate(np.arange(cols, dtype=np.float64), np.arange(rows, dtype=np.float64), shape)


def locate(
    x_px: Floats | Doubles, y_px: Floats | Doubles, shape: tuple[int, int]
) -> tuple[Floats, Floats]:
    """U and v of columns and rows of an image of `shape`, which may have fractions."""
    rows, cols = shape
    half = max(rows, cols) / 2
    u = (x_px - (cols - 1) / 2) / half
    v = (y_px - (rows - 1) / 2) / half
    return u.astype(np.float32), v.astype(np.float32)


def list_exponents(degree: int) -> NDArray[np.int64]:
    """Exponents (m, 3) of red, green and blue in the order of the coefficients: degrees 1 to
    `degree`.
    """
    n = range(degree + 1)
    return np.array(
        [(i, j, k) for i in n for j in n for k in n if 1 <= i + j + k <= degree], np.int64
    )


def compute_gain(reference: NDArray[np.generic]) -> Floats:
    """The factor (rows, cols, 3) from a change in grey levels to q, from the reference image."""
    import cv2

    smooth = cv2.GaussianBlur(reference.astype(np.float32), (0, 0), 3.0)
    return np.asarray(SPAN_GREY / (smooth + np.float32(OFFSET_GREY)), np.float32)


def evaluate(
    model: SlopeModel, change: Floats, u: Floats, v: Floats, where: Mask
) -> tuple[Floats, Floats]:
    """(gx, gy) of an image of q (rows, cols, 3) at the columns `u` and rows `v`.

    Zero outside `where`.
    """
    from pipeline.calibration.slope_model_kernels import evaluate_polynomial

    gx = np.zeros(where.shape, np.float32)
    gy = np.zeros(where.shape, np.float32)
    of_colour = list_exponents(model.colour_degree)
    n_place = len(model.coefficients)
    cols = where.shape[1]
    places = np.ascontiguousarray(np.vander(u, n_place, increasing=True).T, np.float32)
    row = np.empty((n_place, len(of_colour), 2), np.float32)
    ladder = np.ones((3, model.colour_degree + 1, cols), np.float32)
    product = np.empty(cols, np.float32)
    evaluate_polynomial(
        change,
        places,
        v,
        where,
        of_colour,
        model.coefficients,
        np.float32(model.slope_max),
        row,
        ladder,
        product,
        gx,
        gy,
    )
    return gx, gy


def compute_features(samples: SlopeSamples, colour_degree: int, position_degree: int) -> Floats:
    """The monomials (n, position x colour) of the formula, position slowest."""
    q = samples.change
    e = list_exponents(colour_degree)
    ladder = np.stack([q**k for k in range(colour_degree + 1)])  # (degree + 1, n, 3)
    colour = ladder[e[:, 0], :, 0] * ladder[e[:, 1], :, 1] * ladder[e[:, 2], :, 2]  # (m, n)
    # of shape (p, n)
    place = np.stack(
        [samples.u**i * samples.v**j for j, i in _list_position_powers(position_degree)]
    )
    return np.ascontiguousarray(
        (place[:, None, :] * colour[None, :, :]).reshape(-1, len(q)).T, np.float32
    )


def fit(
    samples: SlopeSamples,
    *,
    colour_degree: int,
    position_degree: int,
    ridge: float,
    huber: float = 0.05,
) -> SlopeModel:
    """The polynomial fitted to samples: ridge regression in closed form with three iterations of
    Huber weights.

    `ridge` is relative to the mean square of each monomial and grows with its degree; `huber` is
    the residual in mm/mm from which a sample's influence no longer grows.
    """
    f = compute_features(samples, colour_degree, position_degree)
    target = samples.slopes
    solution: Doubles = np.zeros((f.shape[1], 2))
    w = np.ones(len(f), np.float32)
    place = np.array([j + i for j, i in _list_position_powers(position_degree)])
    stiffer = (
        _RIDGE_GROWTH ** (place[:, None] + list_exponents(colour_degree).sum(axis=1)[None, :] - 1.0)
    ).ravel()
    for _ in range(3):
        weighted = f * w[:, None]
        normal = (weighted.T @ f).astype(np.float64)
        diagonal = np.diag(normal)
        least = 1e-9 * max(float(diagonal.max()), 1e-12)
        normal[np.diag_indices_from(normal)] += ridge * stiffer * diagonal + least
        solution = np.asarray(
            np.linalg.solve(normal, (weighted.T @ target).astype(np.float64)), np.float64
        )
        residual = np.linalg.norm(f @ solution.astype(np.float32) - target, axis=1)
        w = np.minimum(1.0, huber / np.maximum(residual, 1e-6)).astype(np.float32)
    table = np.zeros(
        (position_degree + 1, position_degree + 1, len(list_exponents(colour_degree)), 2),
        np.float32,
    )
    blocks = solution.reshape(-1, table.shape[2], 2)
    for block, (j, i) in zip(blocks, _list_position_powers(position_degree), strict=True):
        table[j, i] = block
    steepest = float(np.linalg.norm(samples.slopes, axis=1).max(initial=0.0))
    return SlopeModel(
        colour_degree=colour_degree,
        position_degree=position_degree,
        coefficients=freeze(table),
        slope_max=max(1.2 * steepest, 1e-3),
    )


def predict(model: SlopeModel, samples: SlopeSamples) -> Floats:
    """Slopes (n, 2) of the samples by the polynomial."""
    f = compute_features(samples, model.colour_degree, model.position_degree)
    place = _list_position_powers(model.position_degree)
    flat = np.stack([model.coefficients[j, i] for j, i in place]).reshape(-1, 2)
    g = f @ flat
    length = np.linalg.norm(g, axis=1, keepdims=True)
    return np.asarray(g * np.minimum(1.0, model.slope_max / np.maximum(length, 1e-9)), np.float32)


def _list_position_powers(degree: int) -> list[tuple[int, int]]:
    return [(j, i) for j in range(degree + 1) for i in range(degree + 1 - j)]
