"""Images of a gel as arrays: `.npy` or `.npz` files, or a folder with one `.npy` file a frame.

Numbers are bytes, 0 to 1, -1 to 1, 0 to 255 or signed differences, and an array may hold the images
of several sensors (`stored_arrays`).
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Image, Stored
from pipeline.core.errors import FileProblem, SettingProblem, escape_text
from pipeline.core.files import read_arrays
from pipeline.core.values.frames import Recording, Stream
from pipeline.io import depth_arrays, file_names, image_files, stored_arrays
from pipeline.io.formats import ReadOptions, RecordingFiles
from pipeline.io.gel_streams import ImageSource, make_gel_stream
from pipeline.io.stored_arrays import ImageStack


def is_colour_file(files: RecordingFiles) -> bool:
    """Whether the arrays hold colour images, or grey ones, and none is named depth.

    Raises FileProblem.
    """
    arrays = read_arrays(files.path, "the recording")
    return not any("depth" in key.lower() for key in arrays) and any(
        stored_arrays.find_colour_axis(a.shape) is not None or stored_arrays.is_grey(a)
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
        k: a for k, a in arrays.items() if stored_arrays.find_colour_axis(a.shape) is not None
    }
    references = {k: a for k, a in images.items() if image_files.is_reference_key(k)}
    frames = {k: a for k, a in images.items() if k not in references}
    if references and not frames:
        raise FileProblem(
            f"the file holds a reference ({', '.join(references)}) and no frames", path
        )
    if not frames:
        key = next(k for k, a in arrays.items() if stored_arrays.is_grey(a))
        raise FileProblem(
            f"{key} has shape {arrays[key].shape} and holds {arrays[key].dtype}: grey images, "
            "which are no depth, and "
            "a gel's slopes are read from its colours; record or convert them in colour",
            path,
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
    if not stored_arrays.split_stacks(first):
        return depth_arrays.read_array_folder(
            replace(files, images=tuple(images)), options, _read_one
        )
    (base,) = _split(first, images[0].stem, images[0])[:1]

    def read_raw(index: int) -> Stored:
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
        raise FileProblem(f"{key} holds no frame", path)
    stacks = stored_arrays.split_stacks(array)
    if not stacks:
        raise FileProblem(
            f"{key} must hold numbers of shape (frames, rows, cols, 3), got {array.dtype} of "
            f"{array.shape}; save the "
            "frames of each sensor and episode as an array of their own",
            path,
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
        own = options
        if is_shared and not _is_asked(stack, options):
            own = replace(options, reference=None)
        source = make_array_source(
            stack,
            key,
            path,
            times_s=times_s,
            reference_values=None if base is None else base.read(0),
        )
        reference = None
        if base is not None and own.reference is None:
            reference = _read_reference(base, stack, reference_key, path)
        if (reference is not None or own.reference is not None) and source.read(
            0
        ).dtype != np.uint8:
            raise FileProblem(
                f"{key} holds differences, which need no reference; leave it out", path
            )
        about = (f"{escape_text(reference_key)} is the reference",)
        stream, own_notes = make_gel_stream(
            source, path, own, name="", reference=reference, about=about
        )
        if stack.name:
            stream = replace(stream, name=f"{stream.name}_{stack.name}")
        streams.append(stream)
        notes += [f"{stream.name}: {note}" if len(stacks) > 1 else note for note in own_notes]
    notes += (
        [f"{escape_text(key)} holds the images of {len(stacks)} sensors"] if len(stacks) > 1 else []
    )
    return Recording(
        path=path,
        format="colour arrays",
        streams=tuple(streams),
        notes=tuple(dict.fromkeys(notes)),
    )


def _is_asked(stack: ImageStack, options: ReadOptions) -> bool:
    """Whether the user names this stream, whose sensor stands before it."""
    return stack.name == options.stream.rpartition("_")[2]


def _read_reference(base: ImageStack, frames: ImageStack, key: str, path: Path) -> Image:
    raw = base.read(0)
    values = stored_arrays.sample_values(frames.read, frames.n_frames)
    scale = stored_arrays.infer_grey_scale(raw.ravel(), key, path, of_reference=values)
    if scale.is_difference:
        raise FileProblem(f"{key} holds a difference, which is no reference; leave it out", path)
    return scale.convert_image(raw, key, path)


def make_array_source(
    stack: ImageStack,
    key: str,
    path: Path,
    *,
    times_s: Doubles | None = None,
    reference_values: Stored | None = None,
) -> ImageSource:
    """The images of one sensor in grey levels.

    `reference_values` are those of a stored reference. Raises FileProblem.
    """
    values = stored_arrays.sample_values(stack.read, stack.n_frames)
    scale = stored_arrays.infer_grey_scale(values, key, path, of_reference=reference_values)
    convert = scale.convert_difference if scale.is_difference else scale.convert_image
    return ImageSource(
        n_frames=stack.n_frames,
        read=lambda index: convert(stack.read(index), f"frame {index} of {key}", path),
        origin=lambda index: f"{path} [{key} {index}]",
        times_s=times_s,
        notes=(scale.note,) if scale.note else (),
    )
