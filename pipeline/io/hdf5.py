"""Read tactoscope recordings frame by frame; a damaged frame does not affect the others."""

from __future__ import annotations

import io
import mmap
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import FileProblem, escape_text, naming_file
from pipeline.core.files import close_on_error, require_file
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera, make_camera
from pipeline.core.geometry.meshes import Mesh, validate_mesh
from pipeline.core.values.frames import Pairing, Recording, Stream, TactileFrame, Truth
from pipeline.io import hdf5_layout as layout
from pipeline.io.formats import with_index_check

if TYPE_CHECKING:  # imported on use
    from pipeline.core.geometry.symmetry import Symmetry

T = TypeVar("T")

NOT_CLOSED_NOTE = "the recording was not closed: it is being written, or its program was killed"
TRUNCATED_NOTE = "the file is cut short"
DAMAGED_NOTE = "cannot be read: that part of the file is damaged"
_MAX_ROTATIONS = 1000  # of a symmetry; an icosahedron has 60
_ROUNDING = 1e-6  # largest entry of R^T R - 1, and of |axis| - 1
TRUTH_TABLE_TITLE = "the table of known truth"


def read(path: Path) -> Recording:
    """A tactoscope recording with its tables of contents read; `close` it when done.

    A truncated file opens with a note, and frames beyond its end raise FileProblem when read.
    Raises FileProblem for another kind of file, a newer version, a missing or wrong unit, and
    content that `hdf5_layout` refuses.
    """
    require_file(path, "the recording", most_bytes=1 << 50)
    notes: list[str] = []
    file = _open_file(path, notes)
    with close_on_error(file.close):
        try:
            return _read_recording(file, path, notes)
        except (*layout.DAMAGE_ERRORS, ArithmeticError) as error:
            raise FileProblem(
                f"the recording's table of contents is damaged ({_shorten(error)})", path
            ) from error


def _read_recording(file: Any, path: Path, notes: list[str]) -> Recording:
    if file.attrs.get("format") != layout.FORMAT:
        raise FileProblem(
            "this HDF5 file is not a tactoscope recording: its attribute 'format' is missing", path
        )
    layout.require_self_contained(file, path)
    version = int(file.attrs.get("format_version", 0))
    if not 1 <= version <= layout.VERSION:
        raise FileProblem(
            f"the recording has format version {version} and this program reads up to "
            f"{layout.VERSION}; update it",
            path,
        )
    notes += layout.read_text_lines(file, "notes", path)
    groups = sorted(file["streams"].items(), key=lambda item: int(item[1].attrs["order"]))
    lost: list[str] = []
    streams = tuple(_read_stream(group, name, path, lost) for name, group in groups)
    if not streams:
        raise FileProblem("the recording has no streams", path)
    body = file.get("object", {})
    mesh = _read_or_default(lambda: _read_mesh(body, path), None, "the object mesh", lost)
    symmetry = None
    if mesh is not None:
        symmetry = _read_or_default(
            lambda: _read_symmetry(body, path), None, "the object's symmetry", lost
        )
    pairs = file.get("pairings", {})
    pairings = tuple(_read_pairing(pairs, key, path) for key in pairs)
    if lost:
        notes.append(f"{', '.join(lost)} {DAMAGED_NOTE}")
    return Recording(
        path=path,
        format=layout.FORMAT,
        streams=streams,
        object_mesh=mesh,
        pairings=pairings,
        notes=tuple(notes),
        close=file.close,
        symmetry=symmetry,
    )


def _read_stream(group: Any, name: str, path: Path, lost: list[str]) -> Stream:
    n, dtype = _validate_stream(group, path)
    grows = bool(group.file.swmr_mode)
    if grows:  # a frame that is partly written does not count
        tables = ("timestamps", "reference_index", "truth/known")
        n = min([n, *(len(group[key]) for key in tables if key in group)])
    sensor = layout.read_sensor_name(group, path)
    shown = escape_text(name)

    def table(key: str, kinds: str, default: NDArray[Any], what: str) -> NDArray[Any]:
        length = None if grows else n
        stored = layout.require_dataset(group, key, layout.UNITS[key], kinds, (length,), path)
        what = f"{what} of {shown!r}"
        return _read_or_default(lambda: stored[:n].astype(default.dtype), default, what, lost)

    times = table("timestamps", layout.FLOAT_KINDS, np.full(n, np.nan), "the timestamps")
    rows = table("reference_index", layout.INTEGER_KINDS, np.full(n, -1), "the table of references")
    known_truth = table(
        "truth/known", layout.INTEGER_KINDS, np.zeros(n, np.int64), TRUTH_TABLE_TITLE
    )
    camera = _read_camera(group, path) if "camera_matrix" in group else None

    # consecutive frames mostly share their reference
    last: tuple[int, NDArray[Any]] = -1, np.empty(0)

    def reference(row: int, index: int) -> NDArray[Any]:
        nonlocal last
        cached = last  # another thread may replace `last`
        if cached[0] != row:
            cached = last = row, _read_row(group["references"], row, index, name, path, dtype)
        return cached[1]

    def frame(index: int) -> TactileFrame:
        _require_open(group, path)
        row = int(rows[index])
        return TactileFrame(
            sensor=sensor,
            image=_read_row(group["frames"], index, index, name, path, dtype),
            reference=None if row < 0 else reference(row, index),
            index=index,
            time_s=float(times[index]),
            origin=f"{path} [{shown}]",
            camera=camera,
        )

    def truth(index: int) -> Truth | None:
        bits = int(known_truth[index])
        if not bits:
            return None
        _require_open(group, path)
        fields = {
            t.field: _read_row(group[t.key], index, index, name, path, t.dtype)
            for t in layout.TRUTH_FIELDS
            if bits & t.bit
        }
        return Truth(**fields)

    for field in layout.TRUTH_FIELDS:
        if field.key not in group and (known_truth & field.bit).any():
            raise FileProblem(
                f"{shown} states that {field.key} is known but does not hold it",
                path,
            )
    return Stream(
        name=shown,
        sensor=sensor,
        n_frames=n,
        frame=with_index_check(frame, n, path),
        truth=with_index_check(truth, n, path),
        has_truth=bool(known_truth.any()),
        times_s=freeze(times),
    )


def _validate_stream(group: Any, path: Path) -> tuple[int, type]:
    """(number of frames, type of an image) of a stream.

    Raises FileProblem where a dataset differs from the layout.
    """
    frames = group["frames"]
    unit, kinds, dtype, colours = (
        ("rgb", layout.UINT8_KINDS, np.uint8, (3,))
        if frames.ndim == 4
        else ("mm", layout.REAL_KINDS, np.float32, ())
    )
    want = (None, None, None, *colours)
    n, *shape = layout.require_dataset(group, "frames", unit, kinds, want, path).shape
    layout.require_dataset(group, "references", unit, kinds, (None, *shape), path)
    for field in layout.TRUTH_FIELDS:
        if field.key in group:
            kinds = layout.REAL_KINDS if field.shape is None else layout.FLOAT_KINDS
            want = (None, *(field.shape or shape[:2]))
            layout.require_dataset(group, field.key, layout.UNITS[field.key], kinds, want, path)
    return int(n), dtype


def _require_open(group: Any, path: Path) -> None:
    if not group:
        raise FileProblem(
            "the recording is closed; read its frames before, as inside its 'with' block", path
        )


def _read_row(
    dataset: Any, row: int, index: int, stream: str, path: Path, dtype: type
) -> NDArray[Any]:
    """One decoded row; raises FileProblem naming file, frame and field for a damaged chunk."""
    key = str(dataset.name).removeprefix(f"/streams/{stream}/")
    if row < dataset.shape[0]:
        try:
            return freeze(layout.decode_frame(dataset[row], dataset).astype(dtype, copy=False))
        except (OSError, RuntimeError):
            pass
    raise FileProblem(
        f"frame {index} of {stream!r}: its {key} are damaged or cut off; try another frame",
        path,
    )


def _read_camera(group: Any, path: Path) -> Camera:
    rows, cols = group["frames"].shape[1:3]
    key = f"{group.name}/camera_matrix".lstrip("/")
    matrix = layout.require_dataset(group, "camera_matrix", "px", layout.REAL_KINDS, (3, 3), path)
    with naming_file(path):
        return make_camera(matrix[()], rows, cols, what=key)


def _read_mesh(group: Any, path: Path) -> Mesh | None:
    if not group:
        return None
    vertices, triangles = (
        layout.require_dataset(group, key, unit, kinds, (None, 3), path)[()].astype(dtype)
        for key, unit, kinds, dtype in (
            ("vertices", "mm", layout.FLOAT_KINDS, np.float64),
            ("triangles", "1", layout.INTEGER_KINDS, np.int64),
        )
    )
    validate_mesh(vertices, triangles, path)
    return Mesh(
        vertices_mm=freeze(vertices),
        triangles=freeze(triangles.astype(np.int32)),
        name=layout.read_text_line(group, "name", path),
    )


def _read_symmetry(group: Any, path: Path) -> Symmetry | None:
    """The symmetry of the object; None where the recording has none.

    Raises FileProblem for matrices that are no rotations, an axis of another length than 1, or a
    missing identity.
    """
    if "symmetry" not in group:
        return None
    from pipeline.core.geometry.symmetry import Symmetry

    def load(key: str, shape: tuple[int | None, ...]) -> Doubles:
        kinds = layout.FLOAT_KINDS
        stored = layout.require_dataset(group["symmetry"], key, "1", kinds, shape, path)
        return freeze(stored[: _MAX_ROTATIONS + 1].astype(np.float64))

    rotations = load("rotations", (None, 3, 3))
    axis = load("axis", (3,)) if "axis" in group["symmetry"] else None
    is_valid = (
        0 < len(rotations) <= _MAX_ROTATIONS
        and np.allclose(rotations.transpose(0, 2, 1) @ rotations, np.eye(3), 0.0, _ROUNDING)
        and (np.linalg.det(rotations) > 0).all()
        and np.allclose(rotations[0], np.eye(3), 0.0, _ROUNDING)
        and (axis is None or abs(np.linalg.norm(axis) - 1.0) < _ROUNDING)
    )
    if not is_valid:
        raise FileProblem(
            "the object's symmetry must be rotations that begin with the identity",
            path,
        )
    return Symmetry(rotations=rotations, axis=axis)


def _read_pairing(pairs: Any, key: str, path: Path) -> Pairing:
    dataset = layout.require_dataset(pairs, key, "mm", layout.FLOAT_KINDS, (4, 4), path)
    source = layout.read_text_line(dataset, "source", path)
    target = layout.read_text_line(dataset, "target", path)
    with naming_file(path):
        matrix = rigid.validate_within_reach(
            dataset[()], f"target_from_source of {source!r} and {target!r}"
        )
    return Pairing(source=source, target=target, target_from_source=freeze(matrix))


def _read_or_default(read_part: Callable[[], T], default: T, what: str, lost: list[str]) -> T:
    """What `read_part` returns, or `default` for a damaged part, whose name is added to `lost`."""
    try:
        return read_part()
    except (OSError, RuntimeError):
        lost.append(what)
        return default


def _open_file(path: Path, notes: list[str]) -> Any:
    import h5py

    try:
        return h5py.File(path, "r")
    except OSError as error:
        if "already open for write" in str(error):
            return _open_unclosed(path, notes)
        if "truncated file" not in str(error):
            raise FileProblem(
                f"the HDF5 file cannot be opened ({_shorten(error)})", path
            ) from error
    try:
        padded = _PaddedFile(path)
        if padded.full_size > 20 * padded.size + (64 << 20):
            raise ValueError(f"{padded.full_size} bytes cannot be right")
        file = h5py.File(padded, "r")
    except (OSError, ValueError, struct.error) as error:
        raise FileProblem(
            "the HDF5 file is cut short before its table of contents", path
        ) from error
    notes.append(
        f"{TRUNCATED_NOTE}: {padded.size} of {padded.full_size} bytes are there; frames beyond "
        "cannot be read"
    )
    return file


class _PaddedFile(io.RawIOBase):
    """A truncated file that reads as if it had its full size: HDF5 refuses it otherwise, and holds
    it in no memory.

    The rest is not zeros: their checksum is zero, so that a lost chunk would pass as valid.
    """

    def __init__(self, path: Path) -> None:
        """Raises ValueError or struct.error for a file without a head."""
        with path.open("rb") as file:
            self._data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self.size, self.full_size = len(self._data), layout.parse_file_size(self._data[:64])
        self._at = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self._at = (
            offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self.full_size}[whence]
        )
        return self._at

    def readinto(self, buffer: Any) -> int:
        data = self._data[self._at : self._at + len(buffer)]
        buffer[:] = data + b"\xa5" * (len(buffer) - len(data))
        self._at += len(buffer)
        return len(buffer)


def _open_unclosed(path: Path, notes: list[str]) -> Any:
    """A recording that grows, or did until its program was killed.

    The writer keeps the file consistent.
    """
    import h5py

    try:
        file = h5py.File(path, "r", swmr=True)
    except OSError as error:
        raise FileProblem(
            f"the recording is being written by another program ({_shorten(error)})", path
        ) from error
    notes.append(NOT_CLOSED_NOTE)
    return file


def _shorten(error: Exception) -> str:
    """The error's text without its preamble."""
    text = str(error)
    return text[text.find("(") + 1 :].rstrip(")") if "(" in text else text
