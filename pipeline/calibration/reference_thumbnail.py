"""By what a calibration knows its unit again: the untouched picture that it was made beside, made small."""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import Image, freeze

_ALONG = 160  # pixels of the longer side: a unit's light is smooth, and a moved lens is a pixel


def make_thumbnail(picture: Image) -> Image:
    """A picture (rows, cols, 3) at no more pixels than tell units apart."""
    import cv2

    share = _ALONG / max(picture.shape[:2])
    if share >= 1.0:
        return freeze(picture.copy())
    rows, cols = (max(1, round(share * n)) for n in picture.shape[:2])
    return freeze(np.asarray(cv2.resize(picture, (cols, rows), interpolation=cv2.INTER_AREA), np.uint8))
