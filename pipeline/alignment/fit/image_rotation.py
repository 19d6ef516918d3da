"""The eight ways to lay a square picture: four quarter turns, and the same mirrored."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T", bound=np.generic)

ORIENTATIONS = range(8)  # 0-3: quarter turns to the left; 4-7: the same, then mirrored left to right


def orient_image(picture: NDArray[T], way: int) -> NDArray[T]:
    """The picture (rows, cols, ...) laid in one of the `WAYS`."""
    quarter = np.rot90(picture, way % 4)
    return quarter[:, ::-1] if way >= 4 else quarter


def rotate_half_turn(way: int) -> int:
    """The way that is half a turn from this one."""
    return (way + 2) % 4 + (way // 4) * 4


def describe_orientation(way: int) -> str:
    """What is done to a picture."""
    quarters = ("not turned", "turned by 90 deg to the left", "turned by 180 deg", "turned by 90 deg to the right")
    return quarters[way % 4] + (", then mirrored left to right" if way >= 4 else "")
