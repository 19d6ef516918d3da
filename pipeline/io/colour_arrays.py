"""Images of a gel as arrays: `.npy` or `.npz` files, or a folder with one `.npy` file a frame.

Numbers are bytes, 0 to 1, -1 to 1, 0 to 255 or signed differences (`grey_scale`); an array may hold
the images of several sensors (`colour_layouts`).
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, Image
from pipeline.core.errors import FileProblem, SettingProblem, escape_text
from pipeline.core.files import read_arrays
from pipeline.core.values.frames import Recording, Stream, TactileFrame
from pipeline.io import colour_layouts, depth_arrays, file_names, grey_scale, image_files
from pipeline.io.colour_layouts import ImageStack
from pipeline.io.formats import ReadOptions, RecordingFiles, with_index_check
from pipeline.io.gel_images import estimate_no_change_grey, make_gel_converter, require_colour
from pipeline.io.reference_images import (
    describe_first_reference,
    find_first_reference,
    sample_frames,
)

_N_COLOUR = 3  # frames that show whether a stack is in colour


def is_colour_file(files: RecordingFiles) -> bool:
    """Whether the arrays hold colour images, or grey ones, and none is named depth.

    Raises FileProblem.
    """
    arrays = read_arrays(files.path, "the recording")
    return not any("depth" in key.lower() for key in arrays) and any(
        colour_layouts.find_colour_axis(a.shape) is not None or colour_layouts.is_grey(a)
        for a in arrays.values()
    )


def read(files: RecordingFiles, options: ReadOptions) -> Recording:
    """One stream of RGB frames a sensor. The reference is `options.reference`, else an array whose
    name says so.

    Without any it is the median of the first frames, if these are alike and untouched. Differences
    imply it. Raises FileProblem or SettingProblem.
    """
    path = files.path
    arrays = read_arrays(files.path, "the recording")
    images = {
        k: a for k, a in arrays.items() if colour_layouts.find_colour_axis(a.shape) is not None
    }
    references = {k: a for k, a in images.items() if image_files.is_reference_key(k)}
    frames = {k: a for k, a in images.items() if k not in references}
    if references and not frames:
        raise FileProblem(
            f"the file holds a reference ({', '.join(references)}) and no frames", path
        )
    if not frames:
        key = next(k for k, a in arrays.items() if colour_layouts.is_grey(a))
        raise FileProblem(
            f"{key} has shape {arrays[key].shape} and holds {arrays[key].dtype}: grey images, "
            "which are no depth, and "
            "a gel's slopes are read from its colours; record or convert them in colour",
            path,
            field=key,
        )
    if len(frames) > 1:
        shapes = ", ".join(f"{k} {a.shape}" for k, a in images.items())
        raise FileProblem(
            f"cannot tell which array holds the frames ({shapes}); keep one in the file", path
        )
    ((key, array),) = frames.items()
    bases = [stack for k, a in references.items() for stack in _split(a, k, path)]
    stacks = _split(array, key, path)
    times_s = depth_arrays.find_times(arrays, stacks[0].n_frames)
    return _make_recording(files, options, key, stacks, next(iter(references), ""), bases, times_s)


def read_series(files: RecordingFiles, options: ReadOptions) -> Recording:
    """A folder with one array a frame, in the order of their names: colour images, or depth of a
    bubble.
    """
    images = [file for file in files.images if not image_files.is_reference_file(file)]
    (first,) = read_arrays(images[0], "the first frame").values()
    if not colour_layouts.split_stacks(first):
        return depth_arrays.read_array_folder(
            replace(files, images=tuple(images)), options, _read_one
        )
    (base,) = _split(first, images[0].stem, images[0])[:1]

    def read_raw(index: int) -> NDArray[np.generic]:
        file = images[index]
        return _split(_read_one(file), file.stem, file)[0].read(0)

    stack = ImageStack(name="", n_frames=len(images), shape=base.shape, read=read_raw)
    references = [file for file in files.images if file not in images]
    bases = [stack for file in references for stack in _split(_read_one(file), file.stem, file)]
    times_s = file_names.parse_times_s(images)
    name = references[0].name if references else ""
    return _make_recording(files, options, f"{images[0].name} ...", (stack,), name, bases, times_s)


def _read_one(file: Path) -> NDArray[Any]:
    (array,) = read_arrays(file, "the frame").values()
    return np.asarray(array)


def _split(array: NDArray[Any], key: str, path: Path) -> tuple[ImageStack, ...]:
    if 0 in array.shape:
        raise FileProblem(f"{key} holds no frame", path, field=key)
    stacks = colour_layouts.split_stacks(array)
    if not stacks:
        raise FileProblem(
            f"{key} must hold numbers of shape (frames, rows, cols, 3), got {array.dtype} of "
            f"{array.shape}; save the "
            "frames of each sensor and episode as an array of their own",
            path,
            field=key,
        )
    return stacks


def _make_recording(
    files: RecordingFiles,
    options: ReadOptions,
    key: str,
    stacks: tuple[ImageStack, ...],
    reference_key: str,
    bases: list[ImageStack],
    times_s: Doubles | None = None,
) -> Recording:
    path = files.path
    is_shared = options.reference is not None and len(stacks) > 1
    if is_shared and not any(_is_asked(stack, options) for stack in stacks):
        raise SettingProblem(
            f"a reference can be given for one sensor, and {key} holds the images of "
            f"{len(stacks)}; choose one with "
            f"--stream, by the name that 'tactoscope inspect' lists: '{path}'"
        )
    streams = list[Stream]()
    notes = list[str]()
    for number, stack in enumerate(stacks):
        base = bases[min(number, len(bases) - 1)] if bases else None
        reference = None
        about = ""
        values = None if base is None else base.read(0)
        if options.reference is not None and (not is_shared or _is_asked(stack, options)):
            reference = image_files.read_rgb(options.reference)
            about = f"{options.reference.name} is the reference"
        elif base is not None:
            reference = _read_reference(base, stack, reference_key, path)
            about = f"{escape_text(reference_key)} is the reference"
        stream, own = make_array_stream(
            stack,
            key,
            path,
            options,
            reference=reference,
            reference_values=values,
            about=about,
            times_s=times_s,
        )
        streams.append(stream)
        notes += [f"{stream.name}: {note}" if len(stacks) > 1 else note for note in own]
    notes += (
        [f"{escape_text(key)} holds the images of {len(stacks)} sensors"] if len(stacks) > 1 else []
    )
    return Recording(
        path=path,
        format="colour arrays",
        streams=tuple(streams),
        notes=(*files.notes, *dict.fromkeys(notes)),
    )


def _is_asked(stack: ImageStack, options: ReadOptions) -> bool:
    """Whether the user names this stream: `make_array_stream` puts its sensor before it."""
    return stack.name == options.stream.rpartition("_")[2]


def _read_reference(base: ImageStack, frames: ImageStack, key: str, path: Path) -> Image:
    raw = base.read(0)
    values = grey_scale.sample_values(frames.read, frames.n_frames)
    scale = grey_scale.infer_grey_scale(raw.ravel(), key, path, of_reference=values)
    if scale.is_difference:
        raise FileProblem(
            f"{key} holds a difference, which is no reference; leave it out", path, field=key
        )
    return scale.convert_image(raw, key, path)


def make_array_stream(
    stack: ImageStack,
    key: str,
    path: Path,
    options: ReadOptions,
    *,
    reference: Image | None = None,
    reference_values: NDArray[np.generic] | None = None,
    about: str = "",
    times_s: Doubles | None = None,
    name: str = "",
) -> tuple[Stream, tuple[str, ...]]:
    """The images of one sensor as a stream, and notes.

    `about` is the note on its `reference`, if one is known.

    `reference_values` are those of a stored reference. `name` may hold that of a sensor. Raises
    FileProblem.
    """
    if reference is not None and reference.shape[:2] != stack.shape:
        raise FileProblem(
            f"the reference has shape {reference.shape}, the frames {(*stack.shape, 3)}", path
        )
    values = grey_scale.sample_values(stack.read, stack.n_frames)
    scale = grey_scale.infer_grey_scale(values, key, path, of_reference=reference_values)
    if scale.is_difference and reference is not None:
        raise FileProblem(
            f"{key} holds differences, which need no reference; leave it out", path, field=key
        )

    def read_image(index: int) -> Image:
        return scale.convert_image(stack.read(index), f"frame {index} of {key}", path)

    def read_raw(index: int) -> Image | Floats:
        if not scale.is_difference:
            return read_image(index)
        return scale.convert_difference(stack.read(index), f"frame {index} of {key}", path)

    if not scale.is_difference:
        require_colour(
            (image for _, image in sample_frames(read_image, stack.n_frames, _N_COLOUR)), path
        )
        if reference is None and estimate_no_change_grey(read_image(0)) is None:
            reference, start, n_averaged = find_first_reference(read_image, stack.n_frames)
            if reference is not None:
                about = describe_first_reference("frame {}".format, start, n_averaged)
    converter = make_gel_converter(
        options.sensor, stack.shape, reference, lambda: read_raw(0), file_names=(name,)
    )
    if converter.implied_reference is None:
        about = about or image_files.NO_REFERENCE_NOTE

    def frame(index: int) -> TactileFrame:
        time_s = math.nan if times_s is None else float(times_s[index])
        return converter.make_frame(read_raw(index), index, f"{path} [{key} {index}]", time_s)

    label = "_".join(part for part in (name or converter.sensor or "images", stack.name) if part)
    stream = Stream(
        name=label,
        sensor=converter.sensor,
        n_frames=stack.n_frames,
        frame=with_index_check(frame, stack.n_frames, path),
        times_s=times_s,
    )
    return stream, tuple(note for note in (*converter.notes, scale.note, about) if note)
