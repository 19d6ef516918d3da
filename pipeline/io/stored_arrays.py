"""Where frames, sensors, rows, columns and colours lie in an array of images, and what its numbers
mean: 0 to 255, 0 to 1, -1 to 1, or differences from the reference.

A few values beyond a range (noise, interpolation) do not change it: ranges are compared with
quantiles. A difference has its mode at "no change", and both signs. What fits several meanings, or
none, is refused.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats, Image, Stored, freeze
from pipeline.core.errors import FileProblem, escape_text
from pipeline.core.frame_lists import spread_indices
from pipeline.core.frozen import frozen

_MIN_SIDE_PX = 8  # of an image; smaller arrays with three columns are points or matrices
_COLOURS = (3, 4, 6)  # of one image: RGB, RGBA, RGB of two sensors
_MAX_SENSORS = 8  # whose frames are in one array; a stack is longer


@frozen
class ImageStack:
    """The images of one sensor in an array."""

    name: str  # "" where the array holds those of one sensor
    n_frames: int
    shape: tuple[int, int]  # (rows, cols) of an image
    read: Callable[[int], Stored]  # (rows, cols, 3) as stored


def split_stacks(array: NDArray[Any]) -> tuple[ImageStack, ...]:
    """The images of every sensor in an array of colour images, in memory or in a file (h5py's);
    () where it holds none.

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

    def make_reader(sensor: int, part: int) -> Callable[[int], Stored]:
        def read(index: int) -> Stored:
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


def is_grey(array: NDArray[Any]) -> bool:
    """Whether an array holds images of one channel of 8 bits (or masks), which are neither
    colour nor depth.
    """
    sides = array.shape[-3:-1] if array.shape[-1:] == (1,) else array.shape[-2:]
    is_image = (
        len(sides) == 2 and min(sides) >= _MIN_SIDE_PX and find_colour_axis(array.shape) is None
    )
    return is_image and array.dtype.itemsize == 1 and array.dtype.kind in "biu"


WHITE = 255.0  # grey level
# frames, and values of all of them, that the range is inferred from
_MAX_SAMPLED = 16
_MAX_VALUES = 2_000_000
# beyond the first: overshoot of noise and resizing; beyond the second: defects
_QUANTILE = 1e-3
_PEAK_QUANTILE = 5e-5
# largest value of a range up to 1: interpolation overshoots a sharp edge by a fifth
_MAX_UNIT = 1.25
_MIN_GREY = 8.0  # grey levels: an image or difference in these reaches more
# of the largest value: overshoot is less; noise of black is more
_MAX_NEGATIVE_SHARE = 0.15
_MIN_NEGATIVE_SHARE = 0.02
# share of a difference that has changed by less than this
_QUIET_GREY = 16.0
_MIN_QUIET_SHARE = 0.5
_HALF_RANGE = 0.52  # signed values up to here may be of -0.5 to 0.5 as well as of -1 to 1
_DIFFERENCE_KEY = re.compile(r"(^|_)(diff|difference|differences|delta)(_|$)", re.IGNORECASE)


@frozen
class GreyScale:
    """The grey level of a stored value: factor * value + offset."""

    factor: float = 1.0
    offset: float = 0.0
    is_difference: bool = False  # grey levels are changes from the reference
    note: str = ""  # "" where bytes are stored

    def convert_image(self, raw: Stored, where: str, path: Path) -> Image:
        """The stored image as bytes; raises FileProblem for values that are not finite."""
        if raw.dtype == np.uint8:
            return freeze(np.ascontiguousarray(raw, np.uint8))
        return freeze(
            np.clip(np.rint(self.convert_difference(raw, where, path)), 0, 255).astype(np.uint8)
        )

    def convert_difference(self, raw: Stored, where: str, path: Path) -> Floats:
        """The stored image in grey levels, which may be signed.

        Raises FileProblem for values that are not finite.
        """
        grey = np.asarray(raw, np.float32) * np.float32(self.factor) + np.float32(self.offset)
        if not np.isfinite(grey).all():
            raise FileProblem(
                f"{where} has values that are not finite (NaN or infinite); repair it, or leave "
                "it out",
                path,
            )
        return freeze(grey)


def sample_values(read: Callable[[int], Stored], n: int) -> Stored:
    """Values of frames spread evenly over a stack of `n`, (k,)."""
    parts = list[Stored]()
    for index in spread_indices(n, _MAX_SAMPLED):
        values = read(index).ravel()
        parts.append(values[:: 1 + values.size * min(n, _MAX_SAMPLED) // _MAX_VALUES])
    return np.concatenate(parts)


def infer_grey_scale(
    values: Stored,
    key: str,
    path: Path,
    *,
    of_reference: Stored | None = None,
) -> GreyScale:
    """The meaning of the sampled `values` of the array `key`.

    Those of a reference of the same type help to tell.

    Raises FileProblem for values that are not finite, and where the meaning cannot be told.
    """
    if values.dtype == np.uint8:
        return GreyScale()
    numbers = np.asarray(values, np.float32)
    if not np.isfinite(numbers).all():
        raise FileProblem(
            f"the array {key!r} has values that are not finite (NaN or infinite); leave those "
            "frames out",
            path,
        )
    is_whole = values.dtype.kind in "iu"
    shown = escape_text(key)
    low_peak, low, high, high_peak = (
        float(q)
        for q in np.quantile(
            numbers, (_PEAK_QUANTILE, _QUANTILE, 1 - _QUANTILE, 1 - _PEAK_QUANTILE)
        )
    )
    unit = _find_unit(max(-low_peak, high_peak), is_whole)
    if (
        unit
        and low < 0
        and (
            (-low > _MAX_NEGATIVE_SHARE * high and _is_quiet(numbers, unit))
            or _DIFFERENCE_KEY.search(key)
        )
    ):
        white = "1 is white" if unit == 1.0 else "255 is white"
        note = f"{shown} has negative values, most of them near 0: {white}, and 0 is no change"
        return GreyScale(factor=WHITE / unit, is_difference=True, note=note)
    if of_reference is not None and of_reference.dtype == values.dtype:
        both = np.append(numbers, np.asarray(of_reference, np.float32))
        low, high = (float(q) for q in np.quantile(both, (_QUANTILE, 1 - _QUANTILE)))
    unit = _find_unit(high, is_whole)
    beyond = -low / high if high > 0 else np.inf
    is_black = unit and low < 0 and beyond > _MIN_NEGATIVE_SHARE and _is_quiet(numbers, unit)
    if unit and beyond <= _MAX_NEGATIVE_SHARE and not is_black:
        note = f"{shown} holds {values.dtype}: {unit:g} is white"
        return GreyScale(factor=WHITE / unit, note=note)
    if not is_whole and not is_black and _HALF_RANGE < max(-low, high) <= _MAX_UNIT and low < 0:
        note = f"{shown} has negative values, and not most of them near 0: -1 is black, 1 is white"
        return GreyScale(factor=0.5 * WHITE, offset=0.5 * WHITE, note=note)
    raise FileProblem(
        f"{key} must hold grey levels of 0 to 255, 0 to 1 or -1 to 1, or differences that are "
        "mostly 0; it holds "
        f"{values.dtype} of {low:.3g} to {high:.3g}: save images as uint8, differences from the "
        "reference as int16",
        path,
    )


def _find_unit(largest: float, is_whole: bool) -> float:
    """The value that is white, 1 or 255; 0 where it cannot be told."""
    if not is_whole and largest <= _MAX_UNIT:
        return 1.0
    return WHITE if (is_whole or largest >= _MIN_GREY) and largest <= WHITE * _MAX_UNIT else 0.0


def _is_quiet(numbers: Floats, unit: float) -> bool:
    """Whether most values are near 0."""
    return float((np.abs(numbers) <= _QUIET_GREY / WHITE * unit).mean()) > _MIN_QUIET_SHARE
