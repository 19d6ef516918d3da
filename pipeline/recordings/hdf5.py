"""Reading tactoscope recordings: frame by frame as they are asked for; one damaged frame does not take the others."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import freeze
from pipeline.base.errors import CalibrationError, FileProblem, TouchError
from pipeline.base.files import require_file
from pipeline.base.text import escape_text
from pipeline.geometry import rigid
from pipeline.geometry.camera import Camera, make_camera
from pipeline.geometry.meshes import Mesh, require_watertight
from pipeline.recordings import hdf5_layout as layout
from pipeline.recordings import hdf5_symmetry
from pipeline.recordings import hdf5_validation as border
from pipeline.recordings.index_check import with_index_check
from pipeline.values.frames import Pairing, Recording, Stream, TactileFrame, Truth

T = TypeVar("T")

NOT_CLOSED_NOTE = "the recording was not closed: it is being written, or its program was ended"
TRUNCATED_NOTE, DAMAGED_NOTE = "the file is cut short", "cannot be read: that part of the file is damaged"
TRUTH_TABLE_TITLE = "the table of what is known"


def read(path: Path) -> Recording:
    """A recording of ours, nothing but its tables of contents read yet; `close` it when done.

    A file that is cut short opens with a note, and frames beyond the cut raise FileProblem when asked for. Raises
    FileProblem when the file is no recording of ours, is newer than this program, says no or a wrong unit, or holds
    what `hdf5_border` keeps out.
    """
    require_file(path, "the recording", most_bytes=1 << 50)
    notes: list[str] = []
    file = _opened(path, notes)
    try:
        return _recording(file, path, notes)
    except TouchError:
        file.close()
        raise
    except (OSError, RuntimeError, LookupError, ValueError, TypeError, AttributeError, ArithmeticError) as error:
        file.close()
        raise FileProblem(f"the recording's table of contents is damaged ({_short(error)})", path) from error


def _recording(file: Any, path: Path, notes: list[str]) -> Recording:
    if file.attrs.get("format") != layout.FORMAT:
        raise FileProblem("this HDF5 file is not a tactoscope recording: its attribute 'format' is missing", path)
    border.require_self_contained(file, path)
    version = int(file.attrs.get("format_version", 0))
    if not 1 <= version <= layout.VERSION:
        raise FileProblem(
            f"the recording has format version {version} and this program reads up to {layout.VERSION}; update it",
            path,
            field="format_version",
        )
    notes += border.read_text_lines(file, "notes", path)
    groups = sorted(file["streams"].items(), key=lambda item: int(item[1].attrs["order"]))
    lost: list[str] = []
    streams = tuple(_stream(group, name, path, lost) for name, group in groups)
    if not streams:
        raise FileProblem("the recording has no streams", path, field="streams")
    mesh = _tolerated(lambda: _mesh(file["object"], path), None, "the object mesh", lost) if "object" in file else None
    symmetry = None
    if mesh is not None:
        symmetry = _tolerated(lambda: hdf5_symmetry.read(file["object"], path), None, "the object's symmetry", lost)
    pairs = file.get("pairings", {})
    pairings = tuple(_pairing(pairs, key, path) for key in pairs)
    if lost:
        notes.append(f"{', '.join(lost)} {DAMAGED_NOTE}")
    return Recording(path=path, format=layout.FORMAT, streams=streams, object_mesh=mesh, pairings=pairings,
                     notes=tuple(notes), close=file.close, symmetry=symmetry)  # fmt: skip


def _stream(group: Any, name: str, path: Path, lost: list[str]) -> Stream:
    n, kept = _checked_stream(group, path)
    grows = bool(group.file.swmr_mode)
    if grows:  # a frame of which only a part is there does not count yet
        n = min([n, *(len(group[key]) for key in ("timestamps", "reference_index", "truth/known") if key in group)])
    sensor, shown = border.read_sensor_name(group, path), escape_text(name)

    def table(key: str, kinds: str, otherwise: float, what: str) -> NDArray[Any]:
        stored = border.require_dataset(group, key, layout.UNITS[key], kinds, (None if grows else n,), path)
        kept_as = np.float64 if kinds == border.FLOAT_KINDS else np.int64
        what = f"{what} of {shown!r}"
        return _tolerated(lambda: stored[:n].astype(kept_as), np.full(n, otherwise, kept_as), what, lost)

    times = table("timestamps", border.FLOAT_KINDS, np.nan, "the timestamps")
    rows = table("reference_index", border.INTEGER_KINDS, -1, "the table of references")
    known = table("truth/known", border.INTEGER_KINDS, 0, TRUTH_TABLE_TITLE)
    camera = _camera(group, path) if "camera_matrix" in group else None

    last: tuple[int, NDArray[Any]] = -1, np.empty(0)  # frames in a row mostly share their untouched reading

    def reference(row: int, index: int) -> NDArray[Any]:
        nonlocal last
        held = last
        if held[0] != row:
            held = last = row, _entry(group["references"], row, index, name, path, kept)
        return held[1]

    def frame(index: int) -> TactileFrame:
        row = int(rows[index])
        return TactileFrame(
            sensor=sensor, image=_entry(group["frames"], index, index, name, path, kept),
            reference=None if row < 0 else reference(row, index),
            index=index, time_s=float(times[index]), origin=f"{path} [{shown}]", camera=camera,
        )  # fmt: skip

    def truth(index: int) -> Truth | None:
        bits = int(known[index])
        if not bits:
            return None
        fields = {
            t.field: _entry(group[t.key], index, index, name, path, t.dtype)
            for t in layout.TRUTH_FIELDS
            if bits & t.bit
        }
        return Truth(**fields)

    for told in layout.TRUTH_FIELDS:
        if told.key not in group and (known & told.bit).any():
            raise FileProblem(f"{shown} says that its {told.key} is known, but does not hold it", path, field=told.key)
    return Stream(name=shown, sensor=sensor, n_frames=n, frame=with_index_check(frame, n, path),
                  truth=with_index_check(truth, n, path), has_truth=bool(known.any()))  # fmt: skip


def _checked_stream(group: Any, path: Path) -> tuple[int, type]:
    """(number of frames, type of a reading) of a stream whose datasets all are what the layout says."""
    frames = group["frames"]
    unit, kinds, kept = (
        ("rgb", border.UINT8_KINDS, np.uint8) if frames.ndim == 4 else ("mm", border.REAL_KINDS, np.float32)
    )
    picture = (None, None, 3) if frames.ndim == 4 else (None, None)
    n, *shape = border.require_dataset(group, "frames", unit, kinds, (None, *picture), path).shape
    border.require_dataset(group, "references", unit, kinds, (None, *shape), path)
    for told in layout.TRUTH_FIELDS:
        if told.key in group:
            kinds = border.REAL_KINDS if told.shape is None else border.FLOAT_KINDS
            border.require_dataset(
                group, told.key, layout.UNITS[told.key], kinds, (None, *(told.shape or shape[:2])), path
            )
    return int(n), kept


def _entry(dataset: Any, row: int, index: int, stream: str, path: Path, kept: type) -> NDArray[Any]:
    """One row, decoded; a chunk whose checksum fails names file, frame and field."""
    key = str(dataset.name).removeprefix(f"/streams/{stream}/")
    if row < dataset.shape[0]:
        try:
            return freeze(layout.decode_frame(dataset[row], dataset).astype(kept, copy=False))
        except (OSError, RuntimeError):
            pass
    raise FileProblem(f"frame {index} of {stream!r}: its {key} are damaged or cut off; other frames can be read", path,
                      field=f"frame {index} {stream}/{key}")  # fmt: skip


def _camera(group: Any, path: Path) -> Camera:
    rows, cols = group["frames"].shape[1:3]
    key = f"{group.name}/camera_matrix".lstrip("/")
    matrix = border.require_dataset(group, "camera_matrix", "px", border.REAL_KINDS, (3, 3), path)
    try:
        return make_camera(matrix[()], rows, cols, what=key)
    except CalibrationError as error:
        raise CalibrationError(f"{error}: '{path}'") from error


def _mesh(group: Any, path: Path) -> Mesh:
    vertices = border.require_dataset(group, "vertices", "mm", border.FLOAT_KINDS, (None, 3), path)[()].astype(
        np.float64
    )
    triangles = border.require_dataset(group, "triangles", "1", border.INTEGER_KINDS, (None, 3), path)[()].astype(
        np.int64
    )
    require_watertight(vertices, triangles, path)
    return Mesh(vertices_mm=freeze(vertices), triangles=freeze(triangles.astype(np.int32)),
                name=border.read_text_line(group, "name", path))  # fmt: skip


def _pairing(pairs: Any, key: str, path: Path) -> Pairing:
    dataset = border.require_dataset(pairs, key, "mm", border.FLOAT_KINDS, (4, 4), path)
    source, target = border.read_text_line(dataset, "source", path), border.read_text_line(dataset, "target", path)
    try:
        matrix = rigid.validate_within_reach(dataset[()], f"target_from_source of {source!r} and {target!r}")
    except CalibrationError as error:
        raise CalibrationError(f"{error}: '{path}'") from error
    return Pairing(source=source, target=target, target_from_source=freeze(matrix))


def _tolerated(take: Callable[[], T], otherwise: T, what: str, lost: list[str]) -> T:
    """What `take` reads, or `otherwise` when that part of the file is damaged, which is then `lost`."""
    try:
        return take()
    except (OSError, RuntimeError):
        lost.append(what)
        return otherwise


def _opened(path: Path, notes: list[str]) -> Any:
    import h5py

    try:
        return h5py.File(path, "r")
    except OSError as error:
        if "already open for write" in str(error):
            return _not_closed(path, notes)
        if "truncated file" not in str(error):
            raise FileProblem(f"the HDF5 file cannot be opened ({_short(error)})", path) from error
    data = path.read_bytes()
    try:
        whole = layout.parse_file_size(data)
        if whole > 20 * len(data) + (64 << 20):
            raise ValueError(f"{whole} bytes cannot be right")
        # The library refuses a file that ends early; with filling in place of the lost end it reads all that is there.
        # Not zeros: their checksum is zero, so that a lost chunk would pass for a good one.
        image = h5py.h5f.open_file_image(data + b"\xa5" * (whole - len(data)))
        file = h5py.File(image)
    except (OSError, ValueError, struct.error) as error:
        raise FileProblem("the HDF5 file is cut short before its table of contents", path) from error
    notes.append(f"{TRUNCATED_NOTE}: {len(data)} of {whole} bytes are there; frames beyond cannot be read")
    return file


def _not_closed(path: Path, notes: list[str]) -> Any:
    """A recording that grows, or did until its program was ended: the writer keeps it in order on disk."""
    import h5py

    try:
        file = h5py.File(path, "r", swmr=True)
    except OSError as error:
        raise FileProblem(f"the recording is being written by another program ({_short(error)})", path) from error
    notes.append(NOT_CLOSED_NOTE)
    return file


def _short(error: Exception) -> str:
    """The library's reason without its preamble."""
    text = str(error)
    return text[text.find("(") + 1 :].rstrip(")") if "(" in text else text
