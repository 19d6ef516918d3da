"""The eight orientations of a square image: four quarter turns, and the same mirrored."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T", bound=np.generic)

ORIENTATIONS = range(8)  # 0-3: quarter turns to the left; 4-7: the same, then mirrored left to right


def orient_image(image: NDArray[T], orientation: int) -> NDArray[T]:
    """Return the image (rows, cols, ...) in one of the `ORIENTATIONS`."""
    quarter = np.rot90(image, orientation % 4)
    return quarter[:, ::-1] if orientation >= 4 else quarter


def rotate_half_turn(orientation: int) -> int:
    """Return the orientation that is half a turn from this one."""
    return (orientation + 2) % 4 + (orientation // 4) * 4


def describe_orientation(orientation: int) -> str:
    """Describe an orientation in words."""
    quarters = ("not rotated", "rotated by 90 deg to the left", "rotated by 180 deg", "rotated by 90 deg to the right")
    return quarters[orientation % 4] + (", then mirrored left to right" if orientation >= 4 else "")
