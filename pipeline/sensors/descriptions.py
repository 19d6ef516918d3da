"""Read the TOML of a sensor; every number is checked for presence, unit, range and finiteness.

Every number is a table `{ value, unit, from }` with `assumed = true` where no source gives it.
`extends = "other"` starts from another sensor's file. Descriptions come with the project, from the
entry point group `tactoscope.sensors` of other packages, whose values are paths of a TOML or of a
folder of them, or by `register_sensors`.
"""

import contextlib
import difflib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, cast

import msgspec
import numpy as np
from msgspec import Meta

from pipeline.core.entry_points import load_entry_points
from pipeline.core.errors import CalibrationError, FileProblem
from pipeline.core.files import read_toml
from pipeline.core.typed_data import convert

DESCRIPTIONS_FOLDER = Path(__file__).parent  # of the project's own descriptions
DESCRIPTION = "the sensor description"
# finite; values derived from it still fit float32
_Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
_UNITS = {"px", "mm", "px/mm", "kPa", "N/mm", "1", "deg", "grey", "rgb", "grey/px", "mm^3"}
_INTRINSICS = {"fx", "fy", "cx", "cy"}


class _Entry(msgspec.Struct, kw_only=True, frozen=True, forbid_unknown_fields=True):
    """One number of a description, or a list of numbers."""

    value: _Number | tuple[_Number, ...]
    unit: str
    source: str = msgspec.field(name="from")
    assumed: bool = False


_registered: list[Path] = []


def register_sensors(path: Path) -> None:
    """Add a description, or all of a folder, for this process."""
    _registered.append(path)


def _check_path(path: object) -> None:
    if not isinstance(path, (str, Path)):
        raise TypeError(f"a path is needed, it is a {type(path).__name__}")
    Path(path).stat()


def find_descriptions() -> dict[str, Path]:
    """Sensor name -> TOML file; a name of the project cannot be replaced."""
    places = [
        *_registered,
        *map(Path, load_entry_points("tactoscope.sensors", object, _check_path)),
        DESCRIPTIONS_FOLDER,
    ]
    files = [
        f
        for place in places
        for f in (sorted(place.glob("*.toml")) if place.is_dir() else (place,))
    ]
    return {file.stem: file for file in files}


def is_description(path: Path) -> bool:
    """Whether a TOML says of which kind a sensor is, or which one it extends."""
    with contextlib.suppress(FileProblem):
        return not {"kind", "extends"}.isdisjoint(read_toml(path, DESCRIPTION))
    return False


def read_description(path: Path, children: tuple[Path, ...] = ()) -> dict[str, Any]:
    """The sections of a description, merged over those that it extends; raises FileProblem.

    `children` are the files that extend this one, so that a circle is refused.
    """
    if path in children:
        raise FileProblem("a sensor description extends itself", path)
    data = read_toml(path, DESCRIPTION)
    parent = data.pop("extends", None)
    if parent is None:
        return data
    if not isinstance(parent, str):
        raise FileProblem("extends must be the name of a sensor", path)
    file = path.parent / f"{parent}.toml"
    if not file.is_file():
        file = find_descriptions().get(parent, file)
    merged = read_description(file, (*children, path))
    resized = data.get("image", merged.get("image")) != merged.get("image")
    camera = data.get("camera")
    if resized and not (isinstance(camera, dict) and camera.keys() >= _INTRINSICS):
        raise FileProblem(
            f"the size of [image] is not that of {parent}, whose optical axis would be off its "
            f"middle; give {', '.join(sorted(_INTRINSICS))} in [camera] as well",
            path,
        )
    for key, value in data.items():
        before = merged.get(key)
        if isinstance(before, dict) and isinstance(value, dict):
            merged[key] = {**before, **value}
        else:
            merged[key] = value
    without = data.get("without", [])
    if not isinstance(without, list):
        raise FileProblem("without must be a list of sections", path)
    return {key: value for key, value in merged.items() if key not in without}


def refuse_unknown_keys(
    found: Iterable[str], known: Iterable[str], path: Path, within: str = ""
) -> None:
    """Raise CalibrationError for a key that nothing reads.

    The sentence names the known key that is most like it, and all.
    """
    for key in found:
        if key not in known:
            nearest = difflib.get_close_matches(key, known, 1, 0.0)[0]
            raise CalibrationError(
                f"the sensor description has {within}{key}; do you mean {within}{nearest}? Known "
                f"are {', '.join(sorted(known))}: '{path}'"
            )


class DescriptionSection:
    """One [section] of a description."""

    def __init__(self, data: Mapping[str, Any], name: str, path: Path, assumed: list[str]) -> None:
        section = data.get(name)
        if not isinstance(section, dict):
            raise CalibrationError(f"the sensor description lacks the section [{name}]: '{path}'")
        self._items = cast("dict[str, Any]", section)
        self._name = name
        self._path = path
        self._assumed = assumed
        self.known_keys = set[str]()  # that somebody has asked for

    def _read_value(
        self, key: str, unit: str, low: float, high: float
    ) -> float | tuple[float, ...]:
        """The value of `key`, given in `unit` and within [low, high].

        Raises CalibrationError and FileProblem.
        """
        where = f"{self._name}.{key}"
        self.known_keys.add(key)
        entry = convert(self._items.get(key), _Entry, DESCRIPTION, self._path, within=where)
        if entry.unit != unit or unit not in _UNITS:
            raise CalibrationError(
                f"{where} must be given in {unit!r}, got {entry.unit!r}: '{self._path}'"
            )
        values = entry.value if isinstance(entry.value, tuple) else (entry.value,)
        if not all(low <= value <= high for value in values):
            got = f"{entry.value:g}" if isinstance(entry.value, float) else repr(entry.value)
            raise CalibrationError(
                f"{where} must lie within {low:g} and {high:g} {unit}, got {got}: '{self._path}'"
            )
        if entry.assumed:
            self._assumed.append(where)
        return entry.value

    def has(self, key: str) -> bool:
        """Whether the section has `key`."""
        self.known_keys.add(key)
        return key in self._items

    def read_number(self, key: str, unit: str, low: float = -np.inf, high: float = np.inf) -> float:
        """A number within [low, high]; raises CalibrationError and FileProblem."""
        value = self._read_value(key, unit, low, high)
        if isinstance(value, tuple):
            raise CalibrationError(
                f"{self._name}.{key} must be one number, got {value!r}: '{self._path}'"
            )
        return value

    def read_vector(
        self, key: str, unit: str, low: float = -np.inf, high: float = np.inf
    ) -> tuple[float, float, float]:
        """Three numbers within [low, high]; raises CalibrationError and FileProblem."""
        value = self._read_value(key, unit, low, high)
        if not isinstance(value, tuple) or len(value) != 3:
            raise CalibrationError(
                f"{self._name}.{key} must be a list of 3 numbers, got {value!r}: '{self._path}'"
            )
        return value
