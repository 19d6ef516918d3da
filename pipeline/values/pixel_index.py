"""The identity map from pixels of a result to pixels of its frame."""

import numpy as np

from pipeline.base.arrays import Indices, freeze
from pipeline.base.memo import memoise


@memoise(16)
def make_pixel_index(shape: tuple[int, int]) -> Indices:
    """0, 1, 2, ... in C order (rows, cols); cached per shape."""
    return freeze(np.arange(shape[0] * shape[1], dtype=np.int32).reshape(shape))
