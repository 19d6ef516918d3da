"""Input format of the paper's end-to-end networks: the change of a frame, resized to a square.

A gel's change is that of its image in shares of full brightness; a bubble's is the displacement of its membrane toward
the camera. Both are normalised by the published mean and standard deviation of the paper's sensors.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, freeze

SIDE = 128
CHANNELS: dict[str, int] = {"gel": 3, "bubble": 1}
MEANS: dict[str, tuple[float, ...]] = {"gel": (-0.0082, -0.0059, -0.0066), "bubble": (3.82,)}  # bubble in mm
STDS: dict[str, tuple[float, ...]] = {"gel": (0.0989, 0.0746, 0.0731), "bubble": (4.24,)}


def compute_change(kind: str, image: NDArray[Any], reference: NDArray[Any]) -> Floats:
    """(rows, cols, channels): brightness change in -1..1 of a gel, imprint in mm of a bubble; 0 if not measured."""
    if kind == "gel":
        return (image.astype(np.float32) - reference.astype(np.float32)) / np.float32(255.0)
    imprint_mm = np.asarray(reference, np.float32) - np.asarray(image, np.float32)
    return np.nan_to_num(imprint_mm, nan=0.0, posinf=0.0, neginf=0.0)[..., None]


def resize_to_square(changed: Floats, side: int = SIDE) -> Floats:
    """(channels, side, side) of a change (rows, cols, channels); area mean for shrinking."""
    import cv2

    rows, cols, channels = changed.shape
    interpolation = cv2.INTER_AREA if min(rows, cols) >= side else cv2.INTER_LINEAR
    small = np.asarray(cv2.resize(changed, (side, side), interpolation=interpolation), np.float32)
    return freeze(np.ascontiguousarray(small.reshape(side, side, channels).transpose(2, 0, 1)))


def resize_from_square(square_change: Floats, shape: tuple[int, int]) -> Floats:
    """The change (rows, cols, channels) of a square (channels, side, side)."""
    import cv2

    changed = cv2.resize(
        np.ascontiguousarray(square_change.transpose(1, 2, 0)), shape[::-1], interpolation=cv2.INTER_CUBIC
    )
    return np.asarray(changed, np.float32).reshape(*shape, len(square_change))


def normalise(square_change: Floats, kind: str) -> Floats:
    """Squares (..., channels, side, side) with zero mean and unit standard deviation over the paper's data."""
    mean, std = _get_statistics(kind)
    return ((square_change - mean) / std).astype(np.float32)


def denormalise(normalised: Floats, kind: str) -> Floats:
    """Invert `normalise`."""
    mean, std = _get_statistics(kind)
    return (normalised * std + mean).astype(np.float32)


def _get_statistics(kind: str) -> tuple[Floats, Floats]:
    mean, std = (np.asarray(v[kind], np.float32)[:, None, None] for v in (MEANS, STDS))
    return mean, std


# Imprint range of the paper's bubble that latent diffusion maps to -1..1.
MIN_IMPRINT_MM, MAX_IMPRINT_MM = -11.6, 22.5


def encode_image(square_change: Floats, kind: str) -> Floats:
    """Three channels in -1..1 for latent diffusion; an imprint is repeated in all channels."""
    if kind == "gel":
        return np.clip(square_change, -1.0, 1.0).astype(np.float32)
    share = (square_change - MIN_IMPRINT_MM) / (MAX_IMPRINT_MM - MIN_IMPRINT_MM)
    return np.repeat(np.clip(2.0 * share - 1.0, -1.0, 1.0).astype(np.float32), 3, axis=-3)


def decode_image(encoded: Floats, kind: str, *, map_twice: bool = False) -> Floats:
    """Invert `encode_image`; an imprint is the mean of the channels, mapped to mm (paper, steps 1 and 2).

    `map_twice` reproduces the released scripts, which map -1..1 to 0..1 twice: every imprint then lies in the upper
    half of the range.
    """
    if kind == "gel":
        return encoded
    share = 0.5 * (np.clip(encoded, -1.0, 1.0).mean(axis=-3, keepdims=True) + 1.0)
    if map_twice:
        share = 0.5 * (share + 1.0)
    return (MIN_IMPRINT_MM + share * (MAX_IMPRINT_MM - MIN_IMPRINT_MM)).astype(np.float32)
