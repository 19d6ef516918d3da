"""A reference where a recording has none or a bad one, made of its own frames.

It is the median of frames with touches at different places, that of the frames without contact, or
one frame.
"""

import contextlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats, Image, freeze
from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.files import open_atomic, require_file, require_separate
from pipeline.core.frame_lists import spread_indices
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import Stream
from pipeline.io.depth_arrays import compute_median_depth
from pipeline.io.folder_contents import find_recording
from pipeline.io.formats import RecordingFiles, get_format
from pipeline.io.image_files import is_image_file, read_rgb
from pipeline.io.reference_images import (
    denoise_reference,
    find_untouched_reference,
    read_until_damaged,
)
from pipeline.io.video import VideoDecoder

_MAX_BYTES = 400_000_000  # of all images together
_MAX_IMAGES = 101
_MIN_IMAGES = 3
# of all frames, of those without contact
MEDIAN = "median"
UNTOUCHED = "untouched"


def make_reference(stream: Stream, frames: str, path: Path) -> tuple[Image | Floats, str]:
    """(reference, note) of a stream's own frames: `MEDIAN`, `UNTOUCHED` or a frame number.

    Raises FileProblem, and SettingProblem where `frames` is none of these.
    """

    def read(index: int) -> NDArray[Any]:
        return stream.frame(index).image

    if frames == MEDIAN:
        image, n_images = _stack_median(stream.n_frames, read, path, SILENT)
        return (
            image,
            f"the median of {n_images} frames is the reference; check that it shows no touch",
        )
    if frames == UNTOUCHED:
        if read(0).ndim == 2:
            raise SettingProblem(
                "untouched frames are detected in colour images; take the median or a frame by "
                "number"
            )
        image, n_images = find_untouched_reference(read, stream.n_frames)
        return image, f"the median of {n_images} frames with least contact is the reference"
    if not frames.isdecimal() or int(frames) >= stream.n_frames:
        raise SettingProblem(
            f"a reference is made of the {MEDIAN!r}, of {UNTOUCHED!r} frames or of a frame from 0 "
            "to "
            f"{stream.n_frames - 1}, got {frames!r}"
        )
    image = read(int(frames))
    n_averaged = 0
    if image.ndim == 3:
        following = read_until_damaged(read, range(int(frames) + 1, stream.n_frames))
        image, n_averaged = denoise_reference(image, following)
    alike = f", as the median with the {n_averaged} alike ones after it," if n_averaged else ""
    return image, f"frame {int(frames)}{alike} is the reference"


def write_reference(recording: Path, out: Path, progress: Progress = SILENT) -> tuple[Image, int]:
    """Write the median image as PNG or JPEG.

    Returns it, (rows, cols, 3) RGB, and the number of images it is of.

    Where more than half of the images touch one place, the median shows that touch. Raises
    FileProblem.
    """
    import cv2

    if not is_image_file(out):
        raise FileProblem("the reference must be an image file such as reference.png", out)
    if not recording.is_dir():
        require_file(recording, "the recording", most_bytes=1 << 50)
    files = find_recording(recording) if recording.is_dir() else RecordingFiles(path=recording)
    require_separate(out, [recording, *files.images])
    image, n_images = _compute_median(files, progress)
    encoded = cv2.imencode(out.suffix.lower(), image[:, :, ::-1])[1]
    with open_atomic(out, "the reference image", read_rgb) as file:
        file.write(encoded.tobytes())
    return image, n_images


def _compute_median(files: RecordingFiles, progress: Progress) -> tuple[Image, int]:
    """The median of images spread evenly over a folder or a video, as they are stored."""
    if files.images:
        images = files.images
        return _stack_median(
            len(images), lambda index: read_rgb(images[index]), files.path, progress
        )
    if files.path.suffix.lower() not in get_format("video").suffixes:
        raise FileProblem(
            "a reference image can be made of a folder of images or a video", files.path
        )
    video = VideoDecoder(files.path)
    try:
        return _stack_median(video.n_frames, video.frame, files.path, progress)
    finally:
        video.close()


def _stack_median(
    n: int, read: Callable[[int], NDArray[Any]], path: Path, progress: Progress
) -> tuple[NDArray[Any], int]:
    def read_each(indices: Iterable[int]) -> Iterator[NDArray[Any]]:
        for index in indices:
            progress.step(index / n, f"image {index}")
            with contextlib.suppress(FileProblem):  # the report of the recording names it
                yield read(index)

    first = next(read_each(range(n)), None)
    if first is None:
        raise FileProblem("none of the images can be read; record them anew", path)
    most = min(_MAX_IMAGES, max(_MIN_IMAGES, _MAX_BYTES // first.nbytes))
    chosen = spread_indices(n, most)
    stack = [image for image in read_each(chosen) if image.shape == first.shape]
    if len(stack) < _MIN_IMAGES:
        raise FileProblem(
            f"a median needs {_MIN_IMAGES} images of one size, there are {len(stack)}", path
        )
    if first.ndim == 2:
        return compute_median_depth(np.stack(stack)), len(stack)
    return freeze(np.median(np.stack(stack), axis=0).round().astype(np.uint8)), len(stack)
