"""Correlation of expected and recorded imprints, beyond what all imprints of the set have in common."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles


def compute_residual(image: NDArray[Any], common: NDArray[Any] | None) -> Doubles:
    """Return an image (n,) less its mean and its projection on `common`, of unit length."""
    values = np.asarray(image, np.float64).ravel()
    values = values - values.mean()
    if common is not None:
        other = np.asarray(common, np.float64).ravel()
        other = other - other.mean()
        values = values - other * ((other @ values) / max(float(other @ other), 1e-30))
    return values / max(float(np.linalg.norm(values)), 1e-30)


def compute_correlation(expected: NDArray[Any], real: NDArray[Any], common: NDArray[Any] | None = None) -> float:
    """Return the correlation of two images of one size; with `common`, that is regressed out of both (partial)."""
    return float(compute_residual(expected, common) @ compute_residual(real, common))


def compute_mean_imprint(images: Sequence[NDArray[Any]]) -> Doubles:
    """Return the mean of images that were each normalised to mean 0 and length 1."""
    each = [compute_residual(p, None) for p in images]
    return np.mean(each, axis=0).reshape(images[0].shape)
