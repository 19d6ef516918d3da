"""Structural similarity of two images (Wang et al. 2004): scikit-image's numbers, per pixel."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles

BORDER_PX = 5  # half the window: nearer to the border it exceeds the image
_SIGMA_PX, _K1, _K2 = 1.5, 0.01, 0.03


def compute_similarity_map(a: NDArray[Any], b: NDArray[Any], data_range: float) -> Doubles:
    """Return the similarity, 1 = equal, at every pixel (rows, cols) of images (rows, cols) or (rows, cols, channels).

    Mean over channels, of finite values. Gaussian window of 11 pixels, population covariance, as scikit-image's
    `structural_similarity` with `gaussian_weights=True, sigma=1.5, use_sample_covariance=False`, which averages pixels
    farther than `BORDER_PX` from the border; pixels beyond it are mirrored.
    """
    one, other = (np.asarray(image, np.float64) for image in (a, b))
    if one.ndim == 3:
        return np.mean([_map(one[..., k], other[..., k], data_range) for k in range(one.shape[2])], axis=0)
    return _map(one, other, data_range)


def _map(a: Doubles, b: Doubles, data_range: float) -> Doubles:
    mean_a, mean_b = _blur(a), _blur(b)
    var_a, var_b = _blur(a * a) - mean_a**2, _blur(b * b) - mean_b**2
    together = _blur(a * b) - mean_a * mean_b
    c1, c2 = (_K1 * data_range) ** 2, (_K2 * data_range) ** 2
    alike = (2 * mean_a * mean_b + c1) * (2 * together + c2)
    return alike / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))


def _blur(image: Doubles) -> Doubles:
    import cv2

    weights = np.asarray(cv2.getGaussianKernel(2 * BORDER_PX + 1, _SIGMA_PX, cv2.CV_64F))[:, 0]
    blurred = cv2.sepFilter2D(image, cv2.CV_64F, weights, weights, borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred, np.float64)
