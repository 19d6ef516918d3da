"""Write tactoscope recordings frame by frame into a temporary file that replaces the old one at
the end.
"""

from __future__ import annotations

import os
import shutil
import zlib
from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.core.errors import ShapeError
from pipeline.core.files import open_atomic
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.values.frames import Pairing, TactileFrame, Truth
from pipeline.io import hdf5
from pipeline.io import hdf5_layout as layout
from pipeline.io.hdf5_layout import Coding

if TYPE_CHECKING:
    from pipeline.core.geometry.symmetry import Symmetry

Effort = Literal["full", "little", "none"]  # of packing an image

_TABLES_BYTES = 2 << 20  # upper limit of tables that one append may add


class RecordingWriter:
    """A recording being written.

    The file at `path` is replaced when the `with` block ends without an error.
    """

    def __init__(
        self,
        path: Path,
        *,
        object_mesh: Mesh | None = None,
        symmetry: Symmetry | None = None,
        pairings: Sequence[Pairing] = (),
        notes: Sequence[str] = (),
        coding: Coding = "plain",
        depth_step_mm: float = 0.0,
    ) -> None:
        """Start a new recording.

        `coding` "row differences" makes images a third smaller; `depth_step_mm` > 0 stores depth
        images as 16-bit multiples of that step instead of float32. Raises FileProblem where nothing
        can be written.
        """
        self._begin(path, coding, depth_step_mm)
        with self._remove_on_error():
            self._open("w")
            self._reserve(0)
            self._file.attrs["format"] = layout.FORMAT
            self._file.attrs["format_version"] = layout.VERSION
            self._file.attrs["notes"] = "\n".join(notes)
            self._file.create_group("streams")
            if object_mesh is not None:
                self._reserve(object_mesh.vertices_mm.nbytes + object_mesh.triangles.nbytes)
                group = self._file.create_group("object")
                group.attrs["name"] = object_mesh.name
                _write_dataset(group, "vertices", object_mesh.vertices_mm, "mm")
                _write_dataset(group, "triangles", object_mesh.triangles, "1")
                if symmetry is not None:
                    turns = group.create_group("symmetry")
                    for key, values in (("rotations", symmetry.rotations), ("axis", symmetry.axis)):
                        if values is not None:
                            dataset = turns.create_dataset(
                                key, data=values, chunks=values.shape, fletcher32=True
                            )
                            dataset.attrs["unit"] = layout.UNITS[f"symmetry/{key}"]
            for k, pair in enumerate(pairings):
                dataset = _write_dataset(
                    self._file.require_group("pairings"), str(k), pair.target_from_source, "mm"
                )
                dataset.attrs["source"] = pair.source
                dataset.attrs["target"] = pair.target

    @classmethod
    def open_for_append(cls, path: Path) -> RecordingWriter:
        """Append to an existing recording, on a copy, so that an interrupted append changes
        nothing.
        """
        recording = hdf5.read(path)  # refuses another kind of file before the copy
        recording.close()
        writer = cls.__new__(cls)
        writer._begin(path, "plain", 0.0)
        writer._n_before = {stream.name: stream.n_frames for stream in recording.streams}
        with writer._remove_on_error():
            with path.open("rb") as old:
                shutil.copyfileobj(old, writer._temporary)
            writer._temporary.flush()
            writer._open("r+")
        return writer

    def _begin(self, path: Path, coding: Coding, depth_step_mm: float) -> None:
        self._path = path
        self._coding: Coding = coding
        self._depth_step_mm = depth_step_mm
        self._last_reference: dict[str, NDArray[Any]] = {}
        self._n_before: dict[str, int] = {}
        self._file: Any = None
        self._place = ExitStack()
        self._temporary = self._open_place(path)

    def _open_place(self, path: Path) -> BinaryIO:
        """The file that is written, open until the writer ends."""
        return self._place.enter_context(open_atomic(path, "the recording", self._read_added))

    def _open(self, mode: str) -> None:
        import h5py

        # Chunks are written at once: chunks that HDF5 holds back would end the process when a disk
        # is full.
        options: dict[str, Any] = {
            "libver": ("v110", "latest"),
            "meta_block_size": layout.METADATA_BYTES,
        }
        self._file = self._place.enter_context(
            h5py.File(self._temporary.name, mode, rdcc_nbytes=0, **options)
        )

    @contextmanager
    def _remove_on_error(self) -> Generator[None, None, None]:
        with ExitStack() as cleanup:
            cleanup.push(self.__exit__)
            yield
            cleanup.pop_all()

    def _reserve(self, n_bytes: int) -> None:
        """Reserve space for `n_bytes` more and their tables.

        Raises OSError before anything is written.
        """
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(
                self._temporary.fileno(), 0, self._file.id.get_filesize() + n_bytes + _TABLES_BYTES
            )

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self,
        _kind: type[BaseException] | None,
        error: BaseException | None,
        _at: TracebackType | None,
    ) -> None:
        with self._place:
            if error is not None:
                raise error
            self._file.close()
            layout.truncate_to_size(self._temporary)

    def _read_added(self, path: Path) -> None:
        """Read every added frame of a written file."""
        with closing(hdf5.read(path)) as written:
            for stream in written.streams:
                for index in range(self._n_before.get(stream.name, 0), stream.n_frames):
                    stream.frame(index)
                    stream.truth(index)

    def append(
        self,
        stream: str,
        frame: TactileFrame,
        truth: Truth | None = None,
        *,
        effort: Effort = "full",
    ) -> None:
        """Add one frame to `stream`, which its first frame creates.

        An image of 8 bits packed with little effort takes a third of the time, one with none a
        tenth and twice the space. Raises ShapeError for another shape.
        """
        streams = self._file["streams"]
        group = streams[stream] if stream in streams else self._new_stream(stream, frame)
        frames = group["frames"]
        index = frames.shape[0]
        self._reserve(4 * frame.image.nbytes)  # image, reference, and two images of truth
        if frame.image.shape != frames.shape[1:]:
            raise ShapeError(
                f"frame {index} of {stream!r} must have shape {frames.shape[1:]}, got "
                f"{frame.image.shape}"
            )
        pixels = layout.encode_frame(frame.image, frames, f"frame {index} of {stream!r}")
        reference = self._reference_row(stream, group, frame)
        if effort == "full" or (effort == "little" and pixels.itemsize > 1):
            _append_row(frames, index, pixels)
        else:
            _append_chunk(frames, index, pixels, effort)
        _append_row(group["timestamps"], index, frame.time_s)
        _append_row(group["reference_index"], index, reference)
        self._append_truth(group, index, truth)
        if index == 0:
            self._file.flush()  # tables come before the frames, so that a truncated file keeps them

    def write_group(
        self,
        name: str,
        tables: Mapping[str, tuple[NDArray[Any], str]],
        attributes: Mapping[str, str],
    ) -> None:
        """Add a group next to the streams: datasets with their units, and texts as attributes."""
        self._reserve(sum(values.nbytes for values, _ in tables.values()))
        group = self._file.create_group(name)
        group.attrs.update(attributes)
        for key, (values, unit) in tables.items():
            _write_dataset(group, key, values, unit)

    def _new_stream(self, name: str, frame: TactileFrame) -> Any:
        if "/" in name or name in ("", "."):
            raise ShapeError(f"a stream needs a name without '/', got {name!r}")
        group = self._file["streams"].create_group(name)
        group.attrs["sensor"] = frame.sensor
        group.attrs["order"] = len(self._file["streams"]) - 1
        step = self._depth_step_mm if frame.is_depth else 0.0
        dtype: type = np.uint8
        if frame.is_depth:
            dtype = np.uint16 if step > 0 else np.float32
        for key in ("frames", "references"):
            _create_stack(
                group,
                key,
                frame.image.shape,
                dtype,
                "mm" if frame.is_depth else "rgb",
                coding=self._coding,
                step_mm=step,
                nan_code=65535,
            )
        _create_stack(group, "timestamps", (), np.float64, "s", fill=np.nan)
        _create_stack(group, "reference_index", (), np.int32, "1", fill=-1)
        _create_stack(group, "truth/known", (), np.uint8, "1")
        if frame.camera is not None:
            _write_dataset(group, "camera_matrix", frame.camera.matrix, "px")
        return group

    def _reference_row(self, stream: str, group: Any, frame: TactileFrame) -> int:
        """The row of this frame's reference, which is added if it differs from the last one."""
        reference = frame.reference
        stored = group["references"]
        if reference is None:
            return -1
        last = self._last_reference.get(stream)
        if last is reference or (
            last is not None and np.array_equal(last, reference, equal_nan=frame.is_depth)
        ):
            return stored.shape[0] - 1
        if reference.shape != frame.image.shape:
            raise ShapeError(
                f"the reference of {stream!r} must have shape {frame.image.shape}, got "
                f"{reference.shape}"
            )
        coded = layout.encode_frame(reference, stored, f"the reference of {stream!r}")
        # of the recording that is appended to
        before = stored[-1] if last is None and stored.shape[0] else None
        if before is None or not np.array_equal(before, coded, equal_nan=before.dtype.kind == "f"):
            _append_row(stored, stored.shape[0], coded)
        self._last_reference[stream] = reference
        return stored.shape[0] - 1

    def _append_truth(self, group: Any, index: int, truth: Truth | None) -> None:
        shape: tuple[int, ...] = group["frames"].shape[1:3]
        known = 0
        step = layout.BUBBLE_STEP_MM if group["frames"].ndim == 3 else layout.GEL_STEP_MM
        for field in layout.TRUTH_FIELDS:
            key = field.key
            want = field.shape or shape
            values = getattr(truth or Truth(), field.field)
            if values is None:
                continue
            if values.shape != want:
                raise ShapeError(
                    f"{key} of frame {index} must have shape {want}, got {values.shape}"
                )
            if key not in group:
                is_length = field.dtype is np.float32
                _create_stack(
                    group,
                    key,
                    want,
                    field.stored,
                    layout.UNITS[key],
                    coding=self._coding if is_length else "plain",
                    step_mm=step if is_length else 0.0,
                    nan_code=-32768,
                    fill=field.fill,
                )
            _append_row(
                group[key],
                index,
                layout.encode_frame(values, group[key], f"{key} of frame {index}"),
            )
            known |= field.bit
        _append_row(group["truth/known"], index, known)


def _create_stack(
    group: Any,
    key: str,
    shape: tuple[int, ...],
    dtype: Any,
    unit: str,
    *,
    coding: Coding = "plain",
    step_mm: float = 0.0,
    nan_code: int = 0,
    fill: Any = 0,
) -> Any:
    """An empty dataset that grows by one compressed chunk of `shape`.

    Tables of numbers grow by 1024.

    Tables are not compressed, so that a chunk keeps its place near the front of the file when
    written again.
    """
    compression: dict[str, Any] = (
        {"compression": "gzip", "compression_opts": 4, "shuffle": True} if shape else {}
    )
    dataset = group.create_dataset(
        key,
        shape=(0, *shape),
        maxshape=(None, *shape),
        chunks=(1, *shape) if shape else (1024,),
        dtype=dtype,
        fletcher32=True,
        fillvalue=fill,
        **compression,
    )
    dataset.attrs["unit"] = unit
    if step_mm > 0:
        dataset.attrs["step_mm"] = step_mm
        dataset.attrs["nan_code"] = nan_code
    if coding != "plain" and np.issubdtype(np.dtype(dtype), np.integer):
        dataset.attrs["coding"] = coding
    return dataset


def _write_dataset(group: Any, key: str, values: NDArray[Any], unit: str) -> Any:
    dataset = group.create_dataset(
        key, data=values, chunks=True, compression="gzip", shuffle=True, fletcher32=True
    )
    dataset.attrs["unit"] = unit
    return dataset


def _append_row(dataset: Any, index: int, value: Any) -> None:
    """Write `value` at `index`; rows never written hold the fill value and take no space."""
    dataset.resize(index + 1, axis=0)
    dataset[index] = value


# bits of the filters that `_create_stack` puts before the checksum, left out of a chunk
_NO_SHUFFLE = 0b001
_NO_SHUFFLE_OR_DEFLATE = 0b011


def _append_chunk(dataset: Any, index: int, value: NDArray[Any], effort: Effort) -> None:
    """Write `value` at `index` as a chunk with its checksum, which any HDF5 library reads.

    Noise never repeats: to pack it by the shares of its values alone, without a search for
    repetitions, takes a third of the time and less space (`benchmarks/live.py`).
    """
    dataset.resize(index + 1, axis=0)
    content = np.ascontiguousarray(value).tobytes()
    if effort == "little":
        packer = zlib.compressobj(1, strategy=zlib.Z_HUFFMAN_ONLY)
        content = packer.compress(content) + packer.flush()
    chunk = content + _compute_fletcher32(content).to_bytes(4, "little")
    left_out = _NO_SHUFFLE if effort == "little" else _NO_SHUFFLE_OR_DEFLATE
    dataset.id.write_direct_chunk((index, *(0,) * value.ndim), chunk, left_out)


_BLOCK = 512  # words that are summed at once


def _compute_fletcher32(content: bytes) -> int:
    """The checksum of HDF5's filter fletcher32: two sums of 16-bit words, where 65535 stands for
    its multiples.
    """
    words = np.frombuffer(content + b"\0" * (-len(content) % (2 * _BLOCK)), ">u2")
    n_padded = len(words) - (len(content) + 1) // 2
    # sum of each block, and of the sums up to each of its words: both exact in float64
    factors = np.stack([np.ones(_BLOCK), np.arange(_BLOCK, 0, -1)], axis=1)
    one, sums_up_to = (words.reshape(-1, _BLOCK).astype(np.float64) @ factors).astype(np.uint64).T
    blocks_after = np.arange(len(one), dtype=np.uint64)[::-1]
    total = int(one.sum())
    sums = total, int((sums_up_to + _BLOCK * blocks_after * one).sum()) - n_padded * total
    low, high = (total and (total - 1) % 0xFFFF + 1 for total in sums)
    return high << 16 | low
