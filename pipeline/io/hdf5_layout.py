"""Layout of a tactoscope recording in an HDF5 file, for the writer and the reader.

    /                        format, format_version, notes
    /streams/<name>          sensor, order
        frames               (n, rows, cols, 3) uint8 "rgb", or (n, rows, cols) depth "mm"; one
                             chunk per frame
        references           (m, ...) the distinct reference images
        reference_index      (n,) row of `references`, -1 = none
        timestamps           (n,) "s", NaN = not known
        camera_matrix        (3, 3) "px", only where the recording has its own intrinsics
        truth/known          (n,) bits: 1 indentation, 2 contact, 4 pose, 8 force
        truth/indentation    (n, rows, cols) "mm"
        truth/contact        (n, rows, cols) 0 or 1
        truth/sensor_from_object  (n, 4, 4) "mm"
        truth/force          (n, 3) "N" on the sensor: right, down, away from the camera
    /object                  name; vertices (v, 3) "mm", triangles (t, 3)
        symmetry/rotations   (n, 3, 3) rotations about the object's origin that map it onto itself,
                             the identity first
        symmetry/axis        (3,) only where every rotation about it does so; no group `symmetry` =
                             not known
    /pairings/<k>            (4, 4) target_from_source "mm"; source, target
    /rollout                 only in rollouts of tasks: `pipeline/lab/tasks/rollout_file.py`

Every dataset has the attribute `unit` and a Fletcher-32 checksum per chunk; images are compressed.
Lengths may be stored as integers: value = integer * `step_mm`, and `nan_code` is "no value".
`coding` = "row differences" means that each row but the first is its difference from the row above,
modulo the integer's range; `numpy.cumsum` along rows in the same type restores it. This lossless
coding makes noisy images a third smaller.
"""

import math
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats
from pipeline.core.errors import FileProblem, ShapeError, escape_text
from pipeline.core.files import require_budget

FORMAT = "tactoscope recording"
VERSION = 1
# reserved at the front, so that a truncated file keeps its table of contents
METADATA_BYTES = 1 << 16

# what the library raises for a damaged file
DAMAGE_ERRORS = (OSError, RuntimeError, LookupError, ValueError, TypeError, AttributeError)

Coding = Literal["plain", "row differences"]

UNITS: Mapping[str, str] = {
    "reference_index": "1",
    "timestamps": "s",
    "truth/known": "1",
    "truth/indentation": "mm",
    "truth/contact": "1",
    "truth/sensor_from_object": "mm",
    "truth/force": "N",
    "symmetry/rotations": "1",
    "symmetry/axis": "1",
}


class TruthField(NamedTuple):
    """Storage of one field of `Truth` in a stream."""

    field: str
    key: str
    bit: int  # in truth/known
    dtype: type  # of values in memory
    shape: tuple[int, ...] | None  # of one frame; None = the image's
    stored: type  # of values in the file; lengths as integers
    fill: float  # of a frame without it


TRUTH_FIELDS = (
    TruthField("indentation_mm", "truth/indentation", 1, np.float32, None, np.int16, -32768),
    TruthField("contact", "truth/contact", 2, np.bool_, None, np.uint8, 0),
    TruthField(
        "sensor_from_object",
        "truth/sensor_from_object",
        4,
        np.float64,
        (4, 4),
        np.float64,
        np.nan,
    ),
    TruthField("force_n", "truth/force", 8, np.float64, (3,), np.float64, np.nan),
)

_MAX_STEP_MM = 10.0  # largest step of stored lengths, a thousand times that of a depth camera
# Steps of int16 lengths: 0.1 um covers +-3.2 mm of a gel; 1 um covers +-32 mm of a bubble, whose
# noise is 0.4 mm.
GEL_STEP_MM = 1e-4
BUBBLE_STEP_MM = 1e-3


def parse_file_size(head: bytes) -> int:
    """The size in bytes of a file with this head: bytes 28 to 35 of superblocks 2 and 3, which this
    format has.

    Raises ValueError for another superblock, struct.error for a shorter head.
    """
    n_bytes: int = struct.unpack_from("<Q", head, 28)[0]
    if head[8] not in (2, 3):
        raise ValueError(f"unexpected superblock {head[8]}")
    return n_bytes


def truncate_to_size(file: BinaryIO) -> None:
    """Cut off the reserved space after the end of the recording in `file`."""
    file.seek(0)
    file.truncate(parse_file_size(file.read(64)))


def encode_frame(values: NDArray[Any], dataset: Any, what: str) -> NDArray[Any]:
    """One frame of `values` as `dataset` stores it.

    Raises ShapeError for a length beyond its integers.
    """
    if "step_mm" in dataset.attrs:
        limits = np.iinfo(dataset.dtype)
        nan_code = int(dataset.attrs["nan_code"])
        step_mm = float(dataset.attrs["step_mm"])
        counts = np.rint(np.asarray(values, np.float64) / step_mm)
        low = limits.min + (nan_code == limits.min)
        high = limits.max - (nan_code == limits.max)
        if ((counts < low) | (counts > high)).any():
            raise ShapeError(
                f"{what} holds {float(np.nanmax(np.abs(values))):g} mm, but steps of {step_mm:g} "
                f"mm reach from {low * step_mm:g} to {high * step_mm:g} mm"
            )
        values = np.where(np.isnan(counts), nan_code, counts).astype(dataset.dtype)
    if dataset.attrs.get("coding") == "row differences":
        coded = values.copy()
        coded[1:] -= values[:-1]
        return coded
    return values


def decode_frame(stored: NDArray[Any], dataset: Any) -> NDArray[Any]:
    """The values of one stored frame; inverse of `encode_frame`."""
    if dataset.attrs.get("coding") == "row differences":
        stored = np.cumsum(stored, axis=0, dtype=stored.dtype)
    if "step_mm" not in dataset.attrs:
        return stored
    lengths: Floats = (stored * float(dataset.attrs["step_mm"])).astype(np.float32)
    lengths[stored == dataset.attrs["nan_code"]] = np.nan
    return lengths


MAX_OBJECTS = 2_000  # groups and datasets; a recording of twenty sensors has three hundred
MAX_FRAMES = 10_000_000
MAX_VALUES = 1 << 26  # of one chunk, frame or table: a colour image of 22 megapixels
MAX_ATTRIBUTES = 50  # of one part
MAX_TEXT_LENGTH = 20_000  # letters of one attribute
# letters of `numpy.dtype.kind`
REAL_KINDS = "fiu"
FLOAT_KINDS = "f"
INTEGER_KINDS = "iu"
UINT8_KINDS = "u"


def require_self_contained(file: Any, path: Path) -> None:
    """Raise FileProblem for a part in another file, a link, a chunk that is too large, or an
    attribute that unfolds.

    An untrusted recording could otherwise show the content of any file that its reader may open.
    """
    import h5py

    n_bytes = 0
    _check_attributes(file, path)
    for group, key, part in iterate_parts(file, path, MAX_OBJECTS):
        name = _name(group, key)
        if part is None:
            _refuse(f"{name} is a link, which is not allowed", path)
        _check_attributes(part, path)
        if not isinstance(part, h5py.Dataset):
            continue
        if part.is_virtual or part.external:
            _refuse(f"{name} lies in another file, which is not opened", path)
        if part.ndim < 3:  # a table, which is read as a whole and converted
            n_bytes += 2 * 8 * math.prod(part.shape)
            require_budget(n_bytes, f"{name}, with the tables before it,", path)
        if part.chunks and math.prod(part.chunks) * part.dtype.itemsize > 8 * MAX_VALUES:
            _refuse(f"{name} has chunks that are too large", path)


def iterate_parts(file: Any, path: Path, most: int) -> Iterator[tuple[Any, str, Any]]:
    """(group, key, part) of all groups and datasets of a file; a link's part is None.

    Raises FileProblem for more than `most`.
    """
    import h5py

    groups = [file]
    n_objects = 0
    while groups:
        group = groups.pop()
        for key in group:
            n_objects += 1
            if n_objects > most:  # also for a group that holds itself
                _refuse(f"it holds more than {most} parts", path)
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                yield group, key, None
                continue
            part: Any = group[key]
            if isinstance(part, h5py.Group):
                groups.append(part)
            yield group, key, part


def _check_attributes(holder: Any, path: Path) -> None:
    """Refuse attributes that unfold in memory: each may be one number or text, by the type that
    it declares.
    """
    import h5py

    for index in range(h5py.h5a.get_num_attrs(holder.id)):
        attribute = h5py.h5a.open(holder.id, index=index)
        kind = attribute.get_type()
        plain = (h5py.h5t.TypeIntegerID, h5py.h5t.TypeFloatID, h5py.h5t.TypeStringID)
        if (
            not isinstance(kind, plain)
            or math.prod(attribute.shape or ()) > 1
            or kind.get_size() > 4 * MAX_TEXT_LENGTH
            or index >= MAX_ATTRIBUTES
        ):
            name = attribute.name.decode(errors="replace")
            _refuse(f"the attribute {_name(holder, name)} is not one number or text", path)


def require_dataset(
    group: Any, key: str, unit: str, kinds: str, shape: tuple[int | None, ...], path: Path
) -> Any:
    """The dataset `key`, which must have this unit, one of these kinds of numbers and this shape
    (None = any length).

    Raises FileProblem naming it. Datasets of more than two dimensions are read row by row and may
    be large.
    """
    import h5py

    name = _name(group, key)
    dataset: Any = group.get(key)
    if not isinstance(dataset, h5py.Dataset):
        _refuse(f"{name} is missing or no dataset", path)
    stated: Any = dataset.attrs.get("unit")
    if stated != unit:
        how = "has no unit" if stated is None else f"is given in {stated!r}"
        raise FileProblem(f"{name} {how}, want {unit!r}", path)
    most_bytes = 1 if kinds == UINT8_KINDS else 8
    if dataset.dtype.kind not in kinds or dataset.dtype.itemsize > most_bytes:
        _refuse(f"{name} must hold {_KIND_NAMES[kinds]}, got {dataset.dtype}", path)
    if dataset.ndim != len(shape) or any(
        n not in (None, m) for n, m in zip(shape, dataset.shape, strict=True)
    ):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        _refuse(f"{name} must have shape ({wanted}), got {dataset.shape}", path)
    row_shape = dataset.shape[1:] if len(shape) > 2 else dataset.shape
    if math.prod(row_shape) > MAX_VALUES or 0 in dataset.shape[1:] or dataset.shape[0] > MAX_FRAMES:
        _refuse(f"{name} cannot be as large as {dataset.shape}", path)
    if "step_mm" in dataset.attrs or "coding" in dataset.attrs:
        _check_coding(dataset, name, path)
    elif unit == "mm" and dataset.dtype.kind in INTEGER_KINDS:
        _refuse(f"{name} holds whole numbers without step_mm", path)
    return dataset


def read_text_lines(holder: Any, key: str, path: Path) -> list[str]:
    """The lines of a text attribute, escaped for display; raises FileProblem."""
    value = holder.attrs.get(key, "")
    if not isinstance(value, str) or len(value) > MAX_TEXT_LENGTH:
        _refuse(f"{_name(holder, key)} must be a text of at most {MAX_TEXT_LENGTH} letters", path)
    return [escape_text(line) for line in value.split("\n") if line]


def read_text_line(holder: Any, key: str, path: Path) -> str:
    """A text attribute as one line; raises FileProblem."""
    return "\\n".join(read_text_lines(holder, key, path))


def read_sensor_name(group: Any, path: Path) -> str:
    """The name of a stream's sensor.

    A path of a description is refused, since a recording opens no other file.
    """
    name = read_text_line(group, "sensor", path)
    if not all(c.isalnum() or c in "_-" for c in name):
        _refuse(f"the sensor {name!r} is no sensor name; give --sensor", path)
    return name


_KIND_NAMES = {
    UINT8_KINDS: "bytes",
    INTEGER_KINDS: "whole numbers",
    FLOAT_KINDS: "floating-point numbers",
    REAL_KINDS: "real numbers",
}


def _check_coding(dataset: Any, name: str, path: Path) -> None:
    step = dataset.attrs.get("step_mm", 1.0)
    nan_code = dataset.attrs.get("nan_code", 0)
    is_integer = (
        dataset.dtype.kind in INTEGER_KINDS
        and dataset.attrs.get("coding", "row differences") == "row differences"
    )
    if not is_integer or not 0 < float(step) < _MAX_STEP_MM or int(nan_code) != nan_code:
        _refuse(f"{name} has an invalid step_mm, nan_code or coding", path)


def _name(holder: Any, key: str) -> str:
    return escape_text(f"{holder.name}/{key}".lstrip("/"))


def _refuse(why: str, path: Path) -> NoReturn:
    raise FileProblem(f"the recording is refused: {why}", path)
