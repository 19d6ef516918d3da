"""Thumbnail of the reference image that a calibration identifies its sensor instance by."""

import numpy as np

from pipeline.base.arrays import Image, freeze

_LONGER_SIDE_PX = 160  # an instance's light is smooth, and a shifted lens is one of these pixels


def make_thumbnail(image: Image) -> Image:
    """An image (rows, cols, 3), downsampled to the pixels that distinguish instances."""
    import cv2

    share = _LONGER_SIDE_PX / max(image.shape[:2])
    if share >= 1.0:
        return freeze(image.copy())
    rows, cols = (max(1, round(share * n)) for n in image.shape[:2])
    return freeze(np.asarray(cv2.resize(image, (cols, rows), interpolation=cv2.INTER_AREA), np.uint8))
