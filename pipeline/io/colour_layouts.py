"""Where frames, sensors, rows, columns and colours lie in an array of images."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

_MIN_SIDE_PX = 8  # of an image; smaller arrays with three columns are points or matrices
_COLOURS = (3, 4, 6)  # of one image: RGB, RGBA, RGB of two sensors
_MAX_SENSORS = 8  # whose frames are in one array; a stack is longer


class StoredArray(Protocol):
    """An array in memory or in a file."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Length of each axis."""
        ...

    @property
    def dtype(self) -> Any:
        """Type of its numbers."""
        ...

    def __getitem__(self, key: Any, /) -> Any:
        """A part of it, read where it lies in a file."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageStack:
    """The images of one sensor in an array."""

    name: str  # "" where the array holds those of one sensor
    n_frames: int
    shape: tuple[int, int]  # (rows, cols) of an image
    read: Callable[[int], NDArray[np.generic]]  # (rows, cols, 3) as stored


def split_stacks(array: StoredArray) -> tuple[ImageStack, ...]:
    """The images of every sensor in an array of colour images; () where it holds none.

    Axes are (frames, rows, cols, colours) or (frames, colours, rows, cols), of one frame without
    the first; an axis of length 1 before them counts for nothing, another one of a few sensors,
    before or after the frames, is split.
    """
    axis = find_colour_axis(array.shape)
    if (
        axis is None
        or 0 in array.shape
        or array.dtype.kind not in "fiu"
        or array.dtype.itemsize > 8
    ):
        return ()
    leading = array.shape[:-3]
    n_colours = array.shape[axis]
    long = [k for k, n in enumerate(leading) if n != 1]
    frames = max(long, key=lambda k: (leading[k], -k), default=-1)
    sensors = [k for k in long if k != frames]
    if len(sensors) > 1 or any(
        leading[k] > _MAX_SENSORS or leading[k] == leading[frames] for k in sensors
    ):
        return ()
    n_sensors = leading[sensors[0]] if sensors else 1
    n_frames = leading[frames] if long else 1
    shape = array.shape[-3:-1] if axis == -1 else array.shape[-2:]
    n_parts = n_colours // 3  # of the colours

    def make_reader(sensor: int, part: int) -> Callable[[int], NDArray[np.generic]]:
        def read(index: int) -> NDArray[np.generic]:
            place = tuple(
                index if k == frames else sensor if k in sensors else 0 for k in range(len(leading))
            )
            image = np.asarray(array[place] if place else array[...])
            image = image if axis == -1 else np.moveaxis(image, 0, -1)
            return image[..., 3 * part : 3 * part + 3]

        return read

    names = [str(k) for k in range(n_sensors * n_parts)] if n_sensors * n_parts > 1 else [""]
    return tuple(
        ImageStack(
            name=name,
            n_frames=n_frames,
            shape=(shape[0], shape[1]),
            read=make_reader(*divmod(k, n_parts)),
        )
        for k, name in enumerate(names)
    )


def find_colour_axis(shape: tuple[int, ...]) -> int | None:
    """The axis of the colours: last (-1), or before rows and columns (-3).

    None for no colour images.
    """
    if len(shape) >= 3:
        for axis, sides in ((-1, shape[-3:-1]), (-3, shape[-2:])):
            if shape[axis] in _COLOURS and min(sides) >= _MIN_SIDE_PX:
                return axis
    return None


def is_grey(array: StoredArray) -> bool:
    """Whether an array holds images of one channel of 8 bits (or masks), which are neither
    colour nor depth.
    """
    sides = array.shape[-3:-1] if array.shape[-1:] == (1,) else array.shape[-2:]
    is_image = (
        len(sides) == 2 and min(sides) >= _MIN_SIDE_PX and find_colour_axis(array.shape) is None
    )
    return is_image and (array.dtype.kind == "b" or array.dtype in (np.uint8, np.int8))
