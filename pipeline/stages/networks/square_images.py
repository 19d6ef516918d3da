"""Input format of the paper's end-to-end networks: the change of a frame, resized to a square.

The change is that of `SensorKind.compute_relative_change`: of a gel's image in shares of full
brightness, or the displacement of a bubble's membrane toward the camera. It is normalised by the
published mean and standard deviation.
"""

import numpy as np

from pipeline.core.arrays import Floats, freeze
from pipeline.stages.networks.touch_formats import get_touch_format

SIDE = 128


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
        np.ascontiguousarray(square_change.transpose(1, 2, 0)),
        shape[::-1],
        interpolation=cv2.INTER_CUBIC,
    )
    return np.asarray(changed, np.float32).reshape(*shape, len(square_change))


def normalise(square_change: Floats, kind: str) -> Floats:
    """Squares (..., channels, side, side) with zero mean and unit standard deviation over the
    paper's data.
    """
    mean, std = _get_statistics(kind)
    return ((square_change - mean) / std).astype(np.float32)


def denormalise(normalised: Floats, kind: str) -> Floats:
    """Invert `normalise`."""
    mean, std = _get_statistics(kind)
    return (normalised * std + mean).astype(np.float32)


def _get_statistics(kind: str) -> tuple[Floats, Floats]:
    known = get_touch_format(kind)
    mean, std = (np.asarray(v, np.float32)[:, None, None] for v in (known.means, known.stds))
    return mean, std


def encode_image(square_change: Floats, kind: str) -> Floats:
    """Three channels in -1..1 for latent diffusion; an imprint is repeated in all channels."""
    mapped = get_touch_format(kind).image_range
    if mapped is None:
        return np.clip(square_change, -1.0, 1.0).astype(np.float32)
    share = (square_change - mapped[0]) / (mapped[1] - mapped[0])
    return np.repeat(np.clip(2.0 * share - 1.0, -1.0, 1.0).astype(np.float32), 3, axis=-3)


def decode_image(encoded: Floats, kind: str, *, map_twice: bool = False) -> Floats:
    """Invert `encode_image`; an imprint is the mean of the channels, mapped to mm (paper, steps 1
    and 2).

    `map_twice` reproduces the released scripts, which map -1..1 to 0..1 twice: every imprint then
    lies in the upper half of the range.
    """
    mapped = get_touch_format(kind).image_range
    if mapped is None:
        return encoded
    share = 0.5 * (np.clip(encoded, -1.0, 1.0).mean(axis=-3, keepdims=True) + 1.0)
    if map_twice:
        share = 0.5 * (share + 1.0)
    return (mapped[0] + share * (mapped[1] - mapped[0])).astype(np.float32)
