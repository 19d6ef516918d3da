"""Depth scale over the image of a sensor instance, from presses of a ball: a calibration by few presses.

Where depth without calibration makes a ball too large, light differs there from the described one, and the depth of
other touches there is too small by the same factor. The logarithm of that factor is one Gaussian process over the
image: an error that all places share, and a smooth one. Its mean is shrunk by how few presses there are and how far
they are: to the shared error away from them, and to none where they are few.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles, Floats, freeze

# Standard deviations of the logarithm, and a correlation length in half-widths of the image: best of a few on real
# presses of a GelSlim 3 and a DIGIT (`docs/experiments.md`).
_SHARED, _LOCAL, _NOISE = 0.12, 0.1, 0.05
_REACH = 0.4
_LARGEST = 0.5  # logarithm, of a press: more is a press misread
_GRID = 16  # places along each side of the image


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthScale:
    """Factors of depth, and what is left of the presses when each is predicted by the others."""

    factors: Floats  # (_GRID, _GRID) over the whole image, down and across
    errors: Doubles  # (n,) relative diameter errors of held-out presses


def fit_depth_scale(x: Doubles, y: Doubles, ratio: Doubles, shape: tuple[int, int]) -> DepthScale | None:
    """The scale from centres in px and ratios (n,) of measured to true diameter; None without a measured press.

    `shape`: rows and columns of the image.
    """
    rows, cols = shape
    measured = np.isfinite(ratio) & (ratio > 0)
    if not measured.any():
        return None
    half = 0.5 * max(shape)
    places = np.stack([x, y], axis=1)[measured] / half
    logs = np.clip(np.log(ratio[measured]), -_LARGEST, _LARGEST)
    across, down = np.meshgrid(*((np.arange(_GRID) + 0.5) / _GRID * n / half for n in (cols, rows)))
    grid = np.stack([across.ravel(), down.ravel()], axis=1)
    factors = np.exp(_predict(places, logs, grid)).reshape(_GRID, _GRID)
    errors = np.expm1(logs - _predict_each_by_others(places, logs))
    return DepthScale(factors=freeze(factors.astype(np.float32)), errors=errors)


def _predict(places: Doubles, logs: Doubles, at: Doubles) -> Doubles:
    """Mean of the process (k,) at places (k, 2), given its values `logs` (n,) at `places` (n, 2)."""
    known = _compute_covariance(places, places) + _NOISE**2 * np.eye(len(places))
    return np.asarray(_compute_covariance(at, places) @ np.linalg.solve(known, logs), np.float64)


def _predict_each_by_others(places: Doubles, logs: Doubles) -> Doubles:
    """Prediction (n,) of each value by the others; 0 for a single one."""
    every = np.arange(len(logs))
    return np.array([_predict(places[every != i], logs[every != i], places[[i]])[0] for i in every])


def _compute_covariance(first: Doubles, second: Doubles) -> Doubles:
    apart = ((first[:, None] - second) ** 2).sum(axis=-1)
    return np.asarray(_SHARED**2 + _LOCAL**2 * np.exp(-0.5 * apart / _REACH**2), np.float64)
