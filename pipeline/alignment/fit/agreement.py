"""How well an expected imprint agrees with the real one, beyond what every imprint of the set has in common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles


def compute_residual(picture: NDArray[Any], common: NDArray[Any] | None) -> Doubles:
    """What is left (n,) of a picture once its mean and its share of `common` are taken away, of unit length."""
    values = np.asarray(picture, np.float64).ravel()
    values = values - values.mean()
    if common is not None:
        other = np.asarray(common, np.float64).ravel()
        other = other - other.mean()
        values = values - other * ((other @ values) / max(float(other @ other), 1e-30))
    return values / max(float(np.linalg.norm(values)), 1e-30)


def compute_correlation(expected: NDArray[Any], real: NDArray[Any], common: NDArray[Any] | None = None) -> float:
    """Correlation of two pictures of one size; with `common`, after that is regressed out of both (partial)."""
    return float(compute_residual(expected, common) @ compute_residual(real, common))


def compute_mean_imprint(pictures: Sequence[NDArray[Any]]) -> Doubles:
    """What imprints have in common: the mean of pictures that were each brought to mean 0 and length 1."""
    each = [compute_residual(p, None) for p in pictures]
    return np.mean(each, axis=0).reshape(pictures[0].shape)
