"""What a file from a stranger may hold: its own bytes alone, in the types, shapes and sizes that the layout names.

Everything here looks at what the file declares; no array is read, and none is made, before it has passed.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NoReturn

from pipeline.base.errors import FileProblem
from pipeline.base.text import escape_text
from pipeline.recordings import hdf5_layout as layout

MAX_OBJECTS = 2_000  # groups and datasets; a recording of twenty sensors has three hundred
MAX_FRAMES = 10_000_000
MAX_VALUES = 1 << 26  # of one chunk, frame or table: a picture in colour of 22 megapixels, a table of any length above
MAX_TEXT_LENGTH = 20_000  # of one text
REAL_KINDS, FLOAT_KINDS, INTEGER_KINDS, UINT8_KINDS = "fiu", "f", "iu", "u"  # kinds of numbers, in numpy's letters


def require_self_contained(file: Any, path: Path) -> None:
    """Raise FileProblem where any part lies in another file, is a link, or is stored in chunks beyond all size.

    A stranger's recording could otherwise show the content of any file that its reader may open.
    """
    import h5py

    left, n_seen = [file], 0
    while left:
        group = left.pop()
        for key in group:
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                _refuse(f"{_name(group, key)} is a link, which a recording has no use for", path, key)
            part: Any = group[key]
            n_seen += 1
            if n_seen > MAX_OBJECTS:  # also where a group holds itself
                _refuse(f"it holds more than {MAX_OBJECTS} parts", path, key)
            if isinstance(part, h5py.Group):
                left.append(part)
            elif isinstance(part, h5py.Dataset):
                if part.is_virtual or part.external:
                    _refuse(f"{_name(group, key)} lies in another file, which is not opened", path, key)
                if part.chunks and math.prod(part.chunks) * part.dtype.itemsize > 8 * MAX_VALUES:
                    _refuse(f"{_name(group, key)} is kept in chunks beyond all size", path, key)


def require_dataset(group: Any, key: str, unit: str, kinds: str, shape: tuple[int | None, ...], path: Path) -> Any:
    """The dataset `key` if it has this unit, one of these kinds of numbers, and this shape (None = any length).

    Raises FileProblem naming it. What has more than two dimensions is read row by row, so that it may be large.
    """
    import h5py

    found = group.get(key)
    if not isinstance(found, h5py.Dataset):
        _refuse(f"{_name(group, key)} is missing or no dataset", path, key)
    found = layout.require_unit(found, unit, path)
    name, wanted = _name(group, key), ", ".join("any" if n is None else str(n) for n in shape)
    if found.dtype.kind not in kinds or found.dtype.itemsize > (1 if kinds == UINT8_KINDS else 8):
        _refuse(f"{name} must hold {_WORDS[kinds]}, got {found.dtype}", path, key)
    if found.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, found.shape, strict=True)):
        _refuse(f"{name} must have shape ({wanted}), got {found.shape}", path, key)
    at_once = found.shape[1:] if len(shape) > 2 else found.shape
    if math.prod(at_once) > MAX_VALUES or 0 in found.shape[1:] or found.shape[0] > MAX_FRAMES:
        _refuse(f"{name} cannot be as large as {found.shape}", path, key)
    if "step_mm" in found.attrs or "coding" in found.attrs:
        _check_coding(found, name, path)
    elif unit == "mm" and found.dtype.kind in INTEGER_KINDS:
        _refuse(f"{name} holds whole numbers without the step_mm that makes lengths of them", path, key)
    return found


def read_text_lines(holder: Any, key: str, path: Path) -> list[str]:
    """The lines of an attribute that is a text, made safe to show; raises FileProblem."""
    value = holder.attrs.get(key, "")
    if not isinstance(value, str) or len(value) > MAX_TEXT_LENGTH:
        _refuse(f"{_name(holder, key)} must be a text of at most {MAX_TEXT_LENGTH} letters", path, key)
    return [escape_text(line) for line in value.split("\n") if line]


def read_text_line(holder: Any, key: str, path: Path) -> str:
    """An attribute that is a text of one line; raises FileProblem."""
    return "\\n".join(read_text_lines(holder, key, path))


def read_sensor_name(group: Any, path: Path) -> str:
    """The name of a stream's sensor, never the path of a description: a recording opens no other file."""
    name = read_text_line(group, "sensor", path)
    if not all(c.isalnum() or c in "_-" for c in name):
        _refuse(f"the sensor {name!r} is no name of the catalogue; say which it is with --sensor", path, "sensor")
    return name


_WORDS = {
    UINT8_KINDS: "bytes",
    INTEGER_KINDS: "whole numbers",
    FLOAT_KINDS: "floating-point numbers",
    REAL_KINDS: "real numbers",
}


def _check_coding(found: Any, name: str, path: Path) -> None:
    step, nan_code = found.attrs.get("step_mm", 1.0), found.attrs.get("nan_code", 0)
    whole = found.dtype.kind in INTEGER_KINDS and found.attrs.get("coding", "row differences") == "row differences"
    if not whole or not 0 < float(step) < layout.MAX_STEP_MM or int(nan_code) != nan_code:
        _refuse(f"{name} says of its numbers what cannot be right (step_mm, nan_code or coding)", path, name)


def _name(holder: Any, key: str) -> str:
    return escape_text(f"{holder.name}/{key}".lstrip("/"))


def _refuse(why: str, path: Path, field: str) -> NoReturn:
    raise FileProblem(f"the recording is refused: {why}", path, field=field)
