"""Cameras of robot-learning data sets in HDF5, robomimic and ACT (ALOHA), and other HDF5 files of
colour images.

Known layouts are `data/demo_N/obs/<camera>` (robomimic) and `observations/images/<camera>` (ACT,
plain or encoded). Arrays of colour images elsewhere in such a file are read as well. Episodes
follow each other.
"""

import math
import re
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import Any, Never

import numpy as np

from pipeline.core.arrays import Stored
from pipeline.core.errors import FileProblem, escape_text
from pipeline.core.files import close_on_error, require_file
from pipeline.core.values.frames import Recording, Stream
from pipeline.io import stored_arrays
from pipeline.io.colour_arrays import make_array_source
from pipeline.io.file_names import natural_sort_key
from pipeline.io.formats import ReadOptions, RecordingFiles
from pipeline.io.gel_streams import ImageSource, make_streams
from pipeline.io.hdf5_layout import DAMAGE_ERRORS, iterate_parts
from pipeline.io.image_files import decode_rgb
from pipeline.io.stored_arrays import ImageStack

# in the place of an array
_LEFT_OUT = re.compile(r"(^|/)next_obs/|depth|mask|segmentation", re.IGNORECASE)
_ENCODED = (b"\xff\xd8\xff", b"\x89PNG")  # first bytes of an image
_MAX_OBJECTS = 200_000  # groups and arrays of one file
_MAX_BYTES = 1 << 29  # of one frame or chunk, as stated


def is_robot_file(files: RecordingFiles) -> bool:
    """Whether an HDF5 file can be opened and is none of ours."""
    import h5py

    try:
        with h5py.File(files.path, "r") as file:
            return "format" not in file.attrs and "streams" not in file
    except (OSError, RuntimeError, LookupError):
        return False


def read_hdf5(files: RecordingFiles, options: ReadOptions) -> Recording:
    """The tactile cameras of an HDF5 file as streams; raises FileProblem or SettingProblem."""
    import h5py

    path = files.path
    require_file(path, "the data set", most_bytes=1 << 50)
    file = h5py.File(path, "r")
    with close_on_error(file.close):
        try:
            found: dict[str, dict[str, ImageStack]] = {}
            for place, dataset in _walk_datasets(file, path):
                camera, _, episode = (part[::-1] for part in place[::-1].partition("/"))
                for stack in _make_stacks(dataset, place, path):
                    name = "_".join(part for part in (camera, stack.name) if part)
                    found.setdefault(name, {})[episode] = stack
            cameras = {
                camera: [episodes[name] for name in sorted(episodes, key=natural_sort_key)]
                for camera, episodes in found.items()
            }
            if not cameras:
                raise FileProblem(
                    "this HDF5 file is not a tactoscope recording, and holds no colour images of "
                    "robomimic "
                    "(data/demo_0/obs) or ACT (observations/images)",
                    path,
                )
            streams, notes = _make_streams(cameras, path, options)
        except DAMAGE_ERRORS as error:
            raise FileProblem(f"the HDF5 file is damaged ({error!r:.80})", path) from error
    return Recording(
        path=path,
        format="HDF5 of a robot data set",
        streams=streams,
        notes=notes,
        close=file.close,
    )


def _make_streams(
    cameras: Mapping[str, Sequence[ImageStack]], path: Path, options: ReadOptions
) -> tuple[tuple[Stream, ...], tuple[str, ...]]:
    def open_camera(camera: str) -> ImageSource:
        return make_array_source(_join_episodes(camera, cameras[camera], path), camera, path)

    streams, notes = make_streams(
        {escape_text(camera): partial(open_camera, camera) for camera in cameras}, path, options
    )
    n_episodes = max(map(len, cameras.values()))
    if n_episodes > 1:
        notes += (f"{n_episodes} episodes follow each other; the reference is of the first",)
    return streams, notes


def _join_episodes(camera: str, episodes: Sequence[ImageStack], path: Path) -> ImageStack:
    if len({stack.shape for stack in episodes}) > 1:
        raise FileProblem(f"the images of {camera} differ in size between episodes", path)
    ends = list(accumulate(stack.n_frames for stack in episodes))

    def read(index: int) -> Stored:
        at = bisect_right(ends, index)
        return episodes[at].read(index - (ends[at] - episodes[at].n_frames))

    return ImageStack(name="", n_frames=ends[-1], shape=episodes[0].shape, read=read)


def _make_stacks(array: Any, place: str, path: Path) -> tuple[ImageStack, ...]:
    """The images of each sensor in an array; () for other content."""
    if len(array.shape) < 3:
        return _make_encoded_stack(array, place, path)
    stacks = stored_arrays.split_stacks(array)
    row_bytes = math.prod(array.shape[-3:]) * array.dtype.itemsize
    chunk_bytes = math.prod(array.chunks or (1,)) * array.dtype.itemsize
    if stacks and max(row_bytes, chunk_bytes) > _MAX_BYTES:
        raise FileProblem(f"{place} has frames or chunks that are too large", path)

    def guard(read: Callable[[int], Stored]) -> Callable[[int], Stored]:
        def read_checked(index: int) -> Stored:
            try:
                return read(index)
            except Exception as error:  # noqa: BLE001 - codecs have no common root
                _refuse_frame(place, index, path, error)

        return read_checked

    return tuple(
        ImageStack(name=s.name, n_frames=s.n_frames, shape=s.shape, read=guard(s.read))
        for s in stacks
        if s.n_frames
    )


def _make_encoded_stack(array: Any, place: str, path: Path) -> tuple[ImageStack, ...]:
    """PNG or JPEG images, one a row, padded or of varying length."""
    is_bytes = array.dtype == np.uint8 and len(array.shape) == 2
    if not (is_bytes or (array.dtype.kind == "O" and len(array.shape) == 1)) or not array.shape[0]:
        return ()
    if is_bytes and array.shape[1] > _MAX_BYTES:
        raise FileProblem(f"{place} has frames that are too large", path)

    def read_bytes(index: int) -> bytes:
        try:
            return np.asarray(array[index], np.uint8).tobytes()
        except Exception as error:  # noqa: BLE001 - codecs and object types have no common root
            _refuse_frame(place, index, path, error)

    try:
        if not read_bytes(0).startswith(_ENCODED):
            return ()
    except FileProblem:
        return ()
    first = decode_rgb(read_bytes(0), "frame 0", path)
    return (
        ImageStack(
            name="",
            n_frames=array.shape[0],
            shape=(first.shape[0], first.shape[1]),
            read=lambda index: decode_rgb(read_bytes(index), f"frame {index}", path),
        ),
    )


def _refuse_frame(place: str, index: int, path: Path, error: Exception) -> Never:
    where = f"frame {index} of {place}"
    raise FileProblem(
        f"{where} cannot be read; it is damaged or of an unknown coding", path
    ) from error


def _walk_datasets(file: Any, path: Path) -> Iterator[tuple[str, Any]]:
    """(place, dataset) of all that lie in the file itself: links and other files' content are
    left out.
    """
    import h5py

    for _, _, part in iterate_parts(file, path, _MAX_OBJECTS):
        if not isinstance(part, h5py.Dataset) or part.shape is None:
            continue
        place = str(part.name).lstrip("/")
        if not (part.is_virtual or part.external or _LEFT_OUT.search(place)):
            yield place, part
