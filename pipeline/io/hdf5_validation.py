"""Checks of an untrusted recording: only its own bytes, in the types, shapes and sizes of the
layout.

The checks use what the file declares; no array is read or allocated before they pass.
"""

import math
from pathlib import Path
from typing import Any, NoReturn

from pipeline.core.errors import FileProblem, escape_text
from pipeline.core.files import require_budget
from pipeline.io import hdf5_layout as layout

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

    groups = [file]
    n_objects = 0
    n_bytes = 0
    _check_attributes(file, path)
    while groups:
        group = groups.pop()
        for key in group:
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                _refuse(f"{_name(group, key)} is a link, which is not allowed", path, key)
            part: Any = group[key]
            n_objects += 1
            if n_objects > MAX_OBJECTS:  # also for a group that holds itself
                _refuse(f"it holds more than {MAX_OBJECTS} parts", path, key)
            _check_attributes(part, path)
            if isinstance(part, h5py.Group):
                groups.append(part)
            elif isinstance(part, h5py.Dataset):
                if part.is_virtual or part.external:
                    _refuse(
                        f"{_name(group, key)} lies in another file, which is not opened", path, key
                    )
                if part.ndim < 3:  # a table, which is read as a whole and converted
                    n_bytes += 2 * 8 * math.prod(part.shape)
                    require_budget(
                        n_bytes, f"{_name(group, key)}, with the tables before it,", path, field=key
                    )
                if part.chunks and math.prod(part.chunks) * part.dtype.itemsize > 8 * MAX_VALUES:
                    _refuse(f"{_name(group, key)} has chunks that are too large", path, key)


def _check_attributes(holder: Any, path: Path) -> None:
    """Refuse attributes that unfold in memory: each may be one number or text, by the type that
    it declares.
    """
    import h5py

    for index in range(h5py.h5a.get_num_attrs(holder.id)):
        attribute = h5py.h5a.open(holder.id, index=index)
        kind = attribute.get_type()
        shape = attribute.shape
        is_plain = isinstance(
            kind, (h5py.h5t.TypeIntegerID, h5py.h5t.TypeFloatID, h5py.h5t.TypeStringID)
        )
        if (
            not is_plain
            or math.prod(shape or ()) > 1
            or kind.get_size() > 4 * MAX_TEXT_LENGTH
            or index >= MAX_ATTRIBUTES
        ):
            name = attribute.name.decode(errors="replace")
            _refuse(f"the attribute {_name(holder, name)} is not one number or text", path, name)


def require_dataset(
    group: Any, key: str, unit: str, kinds: str, shape: tuple[int | None, ...], path: Path
) -> Any:
    """The dataset `key`, which must have this unit, one of these kinds of numbers and this shape
    (None = any length).

    Raises FileProblem naming it. Datasets of more than two dimensions are read row by row and may
    be large.
    """
    import h5py

    dataset = group.get(key)
    if not isinstance(dataset, h5py.Dataset):
        _refuse(f"{_name(group, key)} is missing or no dataset", path, key)
    dataset = layout.require_unit(dataset, unit, path)
    name = _name(group, key)
    wanted_shape = ", ".join("any" if n is None else str(n) for n in shape)
    if dataset.dtype.kind not in kinds or dataset.dtype.itemsize > (
        1 if kinds == UINT8_KINDS else 8
    ):
        _refuse(f"{name} must hold {_KIND_NAMES[kinds]}, got {dataset.dtype}", path, key)
    if dataset.ndim != len(shape) or any(
        n not in (None, m) for n, m in zip(shape, dataset.shape, strict=True)
    ):
        _refuse(f"{name} must have shape ({wanted_shape}), got {dataset.shape}", path, key)
    row_shape = dataset.shape[1:] if len(shape) > 2 else dataset.shape
    if math.prod(row_shape) > MAX_VALUES or 0 in dataset.shape[1:] or dataset.shape[0] > MAX_FRAMES:
        _refuse(f"{name} cannot be as large as {dataset.shape}", path, key)
    if "step_mm" in dataset.attrs or "coding" in dataset.attrs:
        _check_coding(dataset, name, path)
    elif unit == "mm" and dataset.dtype.kind in INTEGER_KINDS:
        _refuse(f"{name} holds whole numbers without step_mm", path, key)
    return dataset


def read_text_lines(holder: Any, key: str, path: Path) -> list[str]:
    """The lines of a text attribute, escaped for display; raises FileProblem."""
    value = holder.attrs.get(key, "")
    if not isinstance(value, str) or len(value) > MAX_TEXT_LENGTH:
        _refuse(
            f"{_name(holder, key)} must be a text of at most {MAX_TEXT_LENGTH} letters", path, key
        )
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
        _refuse(f"the sensor {name!r} is no sensor name; give --sensor", path, "sensor")
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
    if not is_integer or not 0 < float(step) < layout.MAX_STEP_MM or int(nan_code) != nan_code:
        _refuse(f"{name} has an invalid step_mm, nan_code or coding", path, name)


def _name(holder: Any, key: str) -> str:
    return escape_text(f"{holder.name}/{key}".lstrip("/"))


def _refuse(why: str, path: Path, field: str) -> NoReturn:
    raise FileProblem(f"the recording is refused: {why}", path, field=field)
