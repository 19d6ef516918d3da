"""How a reading is shown to Depth Anything V2: as a picture of three channels, in a size of whole patches.

Loads no torch: it is as much a part of making examples as of using the network.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats

PATCH_PX = 14


def prepare_image(image: NDArray[Any], reference: NDArray[Any], image_content: str) -> Floats:
    """(rows, cols, 3) in 0..1, the least and the largest value at the ends: the picture itself or what has changed.

    Of a depth image it is always the change, three times over, with nothing changed where nothing was read.
    """
    if image.ndim == 2:
        moved = np.nan_to_num(reference.astype(np.float32) - image.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        told = np.repeat(moved[:, :, None], 3, axis=2)
    else:
        told = image.astype(np.float32)
        if image_content == "difference":
            told = told - reference.astype(np.float32)
    low, high = float(told.min()), float(told.max())
    return (told - low) / max(high - low, 1e-6)


def compute_patch_shape(shape: tuple[int, int], side: int) -> tuple[int, int]:
    """Rows and columns of whole patches, the shorter of `side` pixels or the next below, the shape nearly kept."""
    scale = max(side, PATCH_PX) / min(shape)
    rows, cols = (max(1, round(scale * n / PATCH_PX)) * PATCH_PX for n in shape)
    return rows, cols


def resize_to_patches(field: NDArray[Any], side: int) -> Floats:
    """A picture or field brought to `shape_of` its size; enlarged smoothly, shrunk by the mean of areas."""
    import cv2

    rows, cols = compute_patch_shape((field.shape[0], field.shape[1]), side)
    how = cv2.INTER_AREA if rows < field.shape[0] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(np.ascontiguousarray(field, np.float32), (cols, rows), interpolation=how), np.float32)
