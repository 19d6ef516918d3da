"""Prepares a frame for Depth Anything V2: a three-channel image whose size is a multiple of the
patch size.

Loads no torch, since it is also used to make training examples.
"""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats

PATCH_PX = 14  # of DINOv2
ImageContent = Literal["image", "difference", "frame"]


def prepare_image(
    image: NDArray[Any],
    reference: NDArray[Any],
    image_content: str,
    value_range: tuple[float, float] | None = None,
) -> Floats:
    """Image (rows, cols, 3) scaled so that its minimum is 0 and its maximum 1: the frame, or its
    change.

    A depth frame gives its change toward the camera in three equal channels, 0 where there is no
    measurement; with "frame" the depth itself, that of the reference where there is none.
    `value_range` replaces minimum and maximum of the frame for "frame": the paper's lab scales both
    fingers of a grasp alike.
    """
    if image.ndim == 2 and image_content == "frame":
        depth = np.where(np.isfinite(image), image, reference).astype(np.float32)
        filled = np.where(np.isfinite(depth), depth, np.nanmax(depth, initial=0.0))
        shown = np.repeat(filled[:, :, None], 3, axis=2)
    elif image.ndim == 2:
        moved = np.nan_to_num(
            reference.astype(np.float32) - image.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0
        )
        shown = np.repeat(moved[:, :, None], 3, axis=2)
    else:
        shown = image.astype(np.float32)
        if image_content == "difference":
            shown = shown - reference.astype(np.float32)
    low = float(shown.min())
    high = float(shown.max())
    if image_content == "frame" and value_range is not None:
        low, high = value_range
    return (shown - low) / max(high - low, 1e-6)


def compute_patch_shape(shape: tuple[int, int], side: int) -> tuple[int, int]:
    """(rows, cols) in whole patches with a shorter side of about `side` px and nearly the same
    aspect ratio.
    """
    scale = max(side, PATCH_PX) / min(shape)
    rows, cols = (max(1, round(scale * n / PATCH_PX)) * PATCH_PX for n in shape)
    return rows, cols


def resize_to_patches(field: NDArray[Any], side: int) -> Floats:
    """Resize an image or field to `compute_patch_shape` of its size.

    Area mean for shrinking, cubic for enlarging.
    """
    import cv2

    rows, cols = compute_patch_shape((field.shape[0], field.shape[1]), side)
    interpolation = cv2.INTER_AREA if rows < field.shape[0] else cv2.INTER_CUBIC
    return np.asarray(
        cv2.resize(
            np.ascontiguousarray(field, np.float32), (cols, rows), interpolation=interpolation
        ),
        np.float32,
    )
