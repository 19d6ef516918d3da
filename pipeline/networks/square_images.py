"""Touches as the paper's end-to-end networks see them: the change of a reading, squeezed into a square.

A gel's change is that of its picture in shares of full brightness, a bubble's is how far its membrane moved toward the
camera. Both are brought to mean 0 and spread 1 by the published numbers of the paper's own sensors.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, freeze

SIDE = 128
CHANNELS: dict[str, int] = {"gel": 3, "bubble": 1}
MEANS: dict[str, tuple[float, ...]] = {"gel": (-0.0082, -0.0059, -0.0066), "bubble": (3.82,)}  # a bubble's in mm
STDS: dict[str, tuple[float, ...]] = {"gel": (0.0989, 0.0746, 0.0731), "bubble": (4.24,)}


def compute_change(kind: str, image: NDArray[Any], reference: NDArray[Any]) -> Floats:
    """(rows, cols, channels): a gel's change of brightness in -1..1, a bubble's imprint in mm; 0 without a reading."""
    if kind == "gel":
        return (image.astype(np.float32) - reference.astype(np.float32)) / np.float32(255.0)
    moved = np.asarray(reference, np.float32) - np.asarray(image, np.float32)
    return np.nan_to_num(moved, nan=0.0, posinf=0.0, neginf=0.0)[..., None]


def resize_to_square(changed: Floats, side: int = SIDE) -> Floats:
    """(channels, side, side) of a change (rows, cols, channels); what is larger is averaged."""
    import cv2

    rows, cols, channels = changed.shape
    how = cv2.INTER_AREA if min(rows, cols) >= side else cv2.INTER_LINEAR
    small = np.asarray(cv2.resize(changed, (side, side), interpolation=how), np.float32)
    return freeze(np.ascontiguousarray(small.reshape(side, side, channels).transpose(2, 0, 1)))


def resize_from_square(square_change: Floats, shape: tuple[int, int]) -> Floats:
    """The change (rows, cols, channels) of a square (channels, side, side)."""
    import cv2

    changed = cv2.resize(
        np.ascontiguousarray(square_change.transpose(1, 2, 0)), shape[::-1], interpolation=cv2.INTER_CUBIC
    )
    return np.asarray(changed, np.float32).reshape(*shape, len(square_change))


def normalise(square_change: Floats, kind: str) -> Floats:
    """Squares (..., channels, side, side) of mean 0 and spread 1 over the paper's data."""
    mean, spread = _numbers(kind)
    return ((square_change - mean) / spread).astype(np.float32)


def denormalise(normalised: Floats, kind: str) -> Floats:
    """The squares that `normal` made these of."""
    mean, spread = _numbers(kind)
    return (normalised * spread + mean).astype(np.float32)


def _numbers(kind: str) -> tuple[Floats, Floats]:
    mean, spread = (np.asarray(v[kind], np.float32)[:, None, None] for v in (MEANS, STDS))
    return mean, spread


MIN_IMPRINT_MM, MAX_IMPRINT_MM = (
    -11.6,
    22.5,
)  # of the paper's bubble, between which pictures of latent diffusion tell an imprint


def encode_image(square_change: Floats, kind: str) -> Floats:
    """Three channels in -1..1, as latent diffusion pictures a change: an imprint is tiled."""
    if kind == "gel":
        return np.clip(square_change, -1.0, 1.0).astype(np.float32)
    share = (square_change - MIN_IMPRINT_MM) / (MAX_IMPRINT_MM - MIN_IMPRINT_MM)
    return np.repeat(np.clip(2.0 * share - 1.0, -1.0, 1.0).astype(np.float32), 3, axis=-3)


def decode_image(shown: Floats, kind: str, *, map_twice: bool = False) -> Floats:
    """The change that `picture` made this of; of an imprint the mean of its channels, then mm (paper, steps 1 and 2).

    `twice` maps an imprint to mm as the released scripts do, which take -1..1 to 0..1 two times: all of it comes out in
    the upper half of the range.
    """
    if kind == "gel":
        return shown
    share = 0.5 * (np.clip(shown, -1.0, 1.0).mean(axis=-3, keepdims=True) + 1.0)
    if map_twice:
        share = 0.5 * (share + 1.0)
    return (MIN_IMPRINT_MM + share * (MAX_IMPRINT_MM - MIN_IMPRINT_MM)).astype(np.float32)
