"""Images reduced to means over blocks, in which noise averages out and a touch does not."""

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats


def compute_block_means(image: NDArray[np.generic], n_along: int) -> Floats:
    """Means (block rows, block cols, channels) with `n_along` blocks along the longer side; NaN counts as 0.

    `image` is (rows, cols) or (rows, cols, channels).
    """
    import cv2

    rows, cols = image.shape[:2]
    size = tuple(max(1, round(n_along * n / max(rows, cols))) for n in (cols, rows))
    values = np.nan_to_num(np.asarray(image, np.float32))
    means = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)
    return means[..., None] if means.ndim == 2 else means
