"""Arrays of a script as a recording, without a file."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.core.arrays import Floats, Image, freeze
from pipeline.core.errors import ShapeError
from pipeline.core.values.frames import Recording, Stream, TactileFrame
from pipeline.io.depth_arrays import read_depth_image
from pipeline.io.formats import with_index_check
from pipeline.io.image_files import read_rgb
from pipeline.sensors.spec import SensorSpec, describe_unit_problem

PathLike: TypeAlias = "str | os.PathLike[str]"
PATH = Path("arrays")  # what messages call it


def make_recording(
    images: ArrayLike | Sequence[ArrayLike],
    reference: PathLike | ArrayLike | None,
    sensor: SensorSpec,
    times_s: Sequence[float] | None = None,
    path: Path = PATH,
) -> Recording:
    """Return a recording of one sensor from its images.

    Args:
        images: (n, rows, cols, 3) uint8 RGB of a gel, or (n, rows, cols) depth in mm of a bubble,
            NaN or 0 = no value.
        reference: One image of the sensor without contact, of the same shape and type, or its
            file; None = not recorded.
        sensor: The sensor that made them.
        times_s: (n,) seconds, increasing; None = not known.
        path: Where they are from, for messages.

    Raises:
        FileProblem: The reference cannot be read.
        ShapeError: Shapes, types or units are others, or no image is there.
    """
    try:
        stack = np.asarray(images)
    except ValueError:
        raise ShapeError(
            f"the images of {sensor.title} have several shapes; give those of one shape at a time"
        ) from None
    ndim, content = (
        (4, "uint8 RGB (n, rows, cols, 3)")
        if sensor.bubble is None
        else (3, "depth in mm (n, rows, cols)")
    )
    if stack.ndim == ndim - 1:
        raise ShapeError(
            f"images of {sensor.title} must be {content}, got one of {stack.shape}; put it in a "
            "list"
        )
    if stack.ndim != ndim or not stack.size or (ndim == 4 and stack.shape[3] != 3):
        raise ShapeError(
            f"images of {sensor.title} must be {content}, got {stack.dtype} of {stack.shape}"
        )
    frames = [_convert(image, sensor, f"image {index}") for index, image in enumerate(stack)]
    if isinstance(reference, (str, os.PathLike)):
        read_reference = read_rgb if sensor.bubble is None else read_depth_image
        reference = read_reference(Path(reference))
    rest = None if reference is None else _convert(np.asarray(reference), sensor, "the reference")
    if rest is not None and rest.shape != frames[0].shape:
        raise ShapeError(
            f"the reference has shape {rest.shape}, the images {frames[0].shape}; give one of "
            "their shape"
        )
    times = None if times_s is None else np.asarray(times_s, np.float64)
    if times is not None and times.shape != (len(frames),):
        raise ShapeError(
            f"times_s must have shape ({len(frames)},), one time an image, got {times.shape}"
        )

    def read(index: int) -> TactileFrame:
        return TactileFrame(
            sensor=sensor.name,
            image=frames[index],
            reference=rest,
            index=index,
            origin=f"{path} [{index}]",
            time_s=math.nan if times is None else float(times[index]),
        )

    stream = Stream(
        name=sensor.name,
        sensor=sensor.name,
        n_frames=len(frames),
        times_s=times,
        frame=with_index_check(read, len(frames), path),
    )
    return Recording(path=path, format="arrays", streams=(stream,))


def _convert(image: NDArray[Any], sensor: SensorSpec, what: str) -> Image | Floats:
    """Return an immutable copy; raises ShapeError for another type or unit than the sensor's."""
    if sensor.bubble is not None:
        if image.dtype.kind not in "fiu":
            raise ShapeError(
                f"{what} must hold depth in mm, got {image.dtype}; convert it with astype(float)"
            )
        depth_mm = image.astype(np.float32)
        known = depth_mm[np.isfinite(depth_mm) & (depth_mm != 0)]  # cameras write 0 for no value
        if (known < 0).any():
            raise ShapeError(
                f"{what} holds negative depth; give the distance from the camera, positive"
            )
        problem = describe_unit_problem(float(np.median(known)), sensor) if known.size else ""
        if problem:
            raise ShapeError(f"{what} {problem}; give mm")
        return freeze(depth_mm)
    if image.dtype != np.uint8:
        raise ShapeError(
            f"{what} must be uint8, got {image.dtype}; convert values from 0 to 1 with (255 * "
            "images).astype(np.uint8)"
        )
    return cast("Image", freeze(image.copy()))
