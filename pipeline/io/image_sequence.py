"""A stream of images that are read one by one: what videos, MCAP topics and LeRobot cameras
share.
"""

from pathlib import Path
from typing import Protocol

import numpy as np

from pipeline.core.arrays import Image, freeze
from pipeline.core.errors import FileProblem, StageWarning
from pipeline.core.values.frames import Stream, TactileFrame
from pipeline.io import gel_images, image_files
from pipeline.io.formats import ReadOptions, with_index_check
from pipeline.io.gel_images import GelImageConverter, make_gel_converter, require_colour
from pipeline.io.reference_images import (
    denoise_reference,
    describe_first_reference,
    find_bright_start,
    read_until_damaged,
    sample_frames,
    select_reference_frame,
)
from pipeline.io.sensor_guess import find_named_sensor

_N_COLOUR = 3  # frames that show whether it is in colour


class ImageSequence(Protocol):
    """RGB images of one size with times."""

    @property
    def n_frames(self) -> int:
        """Number of images."""
        ...

    def frame(self, index: int) -> Image:
        """(rows, cols, 3) RGB; raises FileProblem for a damaged one."""
        ...

    def time_s(self, index: int) -> float:
        """Time of an image."""
        ...


def make_stream(
    images: ImageSequence, path: Path, options: ReadOptions, *, name: str, may_guess: bool = True
) -> tuple[Stream, tuple[str, ...]]:
    """The stream of a sequence, and notes.

    Without a stated reference its first frames are the reference.

    Dark ones of a camera that starts are none. Where it clearly begins with a touch, a later frame
    is the reference, with a warning. `name` may hold that of a sensor; without `may_guess` a sensor
    that is not stated stays unknown. Raises FileProblem for a first frame that cannot be decoded,
    or a reference of another size.
    """
    first = images.frame(0)
    require_colour(
        (image for _, image in sample_frames(images.frame, images.n_frames, _N_COLOUR)), path
    )
    is_difference = (
        options.reference is None and gel_images.estimate_no_change_grey(first) is not None
    )
    reference = None if is_difference else first
    start = 0
    n_averaged = 0
    n_dark = 0
    if options.reference is not None:
        reference = image_files.read_rgb(options.reference)
        if reference.shape != first.shape:
            raise FileProblem(
                f"the reference has shape {reference.shape}, the frames {first.shape}",
                options.reference,
            )
    elif reference is not None:
        n_dark = find_bright_start(images.frame, images.n_frames)
        reference = images.frame(n_dark) if n_dark else reference
        later = sample_frames(images.frame, images.n_frames, first=n_dark + 1)
        start, reference = select_reference_frame(reference, later) or (n_dark, reference)
        after = read_until_damaged(images.frame, range(start + 1, images.n_frames))
        reference, n_averaged = denoise_reference(reference, after)
    shape = (first.shape[0], first.shape[1])
    if options.sensor or may_guess:
        converter = make_gel_converter(
            options.sensor, shape, reference, lambda: first, file_names=(name,)
        )
    else:
        note = (
            f"{name} names no sensor of touch; if it is one, say which with --stream {name} "
            "--sensor NAME"
        )
        converter = GelImageConverter(
            sensor="",
            reference=reference,
            notes=(note,),
            resampling_fit=None,
            implied_reference=None,
        )
    named = find_named_sensor((name,))
    renamed = bool(options.sensor) and named not in ("", converter.sensor)
    notes = (
        (f"{name} names the sensor {named}; {converter.sensor} is used instead",) if renamed else ()
    )
    about = (
        ()
        if is_difference
        else (_describe_reference(options.reference, start, n_averaged, n_dark),)
    )

    def frame(index: int) -> TactileFrame:
        image = images.frame(index)
        if image.shape != first.shape:
            raise FileProblem(
                f"frame {index} has shape {image.shape}, the first {first.shape}",
                path,
                field=f"frame {index}",
            )
        return converter.make_frame(image, index, f"{path} [frame {index}]", images.time_s(index))

    stream = Stream(
        name=name or converter.sensor or "video",
        sensor=converter.sensor,
        n_frames=images.n_frames,
        frame=with_index_check(frame, images.n_frames, path),
        times_s=freeze(np.array([images.time_s(k) for k in range(images.n_frames)])),
    )
    return stream, (*notes, *converter.notes, *about)


def _describe_reference(reference: Path | None, start: int, n_averaged: int, n_dark: int) -> str:
    if reference is not None:
        return f"{reference.name} is the reference"
    if start > n_dark:
        which = (
            f"frame {start}"
            if not n_averaged
            else f"the median of frames {start} to {start + n_averaged}"
        )
        return StageWarning(
            f"the first frame shows contact, so {which} is taken as the reference; if it shows "
            "contact too, depth is "
            "wrong: give a reference image with --reference"
        )
    if start or n_averaged:
        return describe_first_reference("frame {}".format, start, n_averaged)
    return "the first frame is taken as the reference"
