"""Read the TOML of a sensor; every number is checked for presence, unit, range and finiteness.

Every number is a table `{ value, unit, from }` with `assumed = true` where no source gives it. `extends = "other"`
starts from another sensor's file. Descriptions come with the project, from the entry point group `tactoscope.sensors`
of other packages, whose values are paths of a TOML or of a folder of them, or by `register_sensors`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np

from pipeline.base.entry_points import load_entry_points
from pipeline.base.errors import CalibrationError, FileProblem
from pipeline.base.files import read_toml

DESCRIPTIONS_FOLDER = Path(__file__).parent  # of the project's own descriptions
_MAX_NUMBER = 1e9  # of a description; values derived from it still fit float32
_UNITS = {"px", "mm", "px/mm", "kPa", "N/mm", "1", "deg", "grey", "rgb", "grey/px", "mm^3"}


_registered: list[Path] = []


def register_sensors(path: Path) -> None:
    """Add a description, or all of a folder, for this process."""
    _registered.append(path)


def find_descriptions() -> dict[str, Path]:
    """Sensor name -> TOML file; a name of the project cannot be replaced."""
    places = [*_registered, *map(Path, load_entry_points("tactoscope.sensors")), DESCRIPTIONS_FOLDER]
    files = [f for place in places for f in (sorted(place.glob("*.toml")) if place.is_dir() else (place,))]
    return {file.stem: file for file in files}


def read_description(path: Path, children: tuple[Path, ...] = ()) -> dict[str, Any]:
    """The sections of a description, merged over those that it extends; raises FileProblem.

    `children` are the files that extend this one, so that a circle is refused.
    """
    if path in children:
        raise FileProblem("a sensor description extends itself", path, field="extends")
    data = read_toml(path, "the sensor description")
    parent = data.pop("extends", None)
    if parent is None:
        return data
    if not isinstance(parent, str):
        raise FileProblem("extends must be the name of a sensor", path, field="extends")
    file = path.parent / f"{parent}.toml"
    if not file.is_file():
        file = find_descriptions().get(parent, file)
    merged = read_description(file, (*children, path))
    for key, value in data.items():
        before = merged.get(key)
        merged[key] = {**before, **value} if isinstance(before, dict) and isinstance(value, dict) else value
    without = data.get("without", [])
    if not isinstance(without, list):
        raise FileProblem("without must be a list of sections", path, field="without")
    return {key: value for key, value in merged.items() if key not in without}


class DescriptionSection:
    """One [section] of a description."""

    def __init__(self, data: Mapping[str, Any], name: str, path: Path, assumed: list[str]) -> None:
        section = data.get(name)
        if not isinstance(section, dict):
            raise CalibrationError(f"the sensor description lacks the section [{name}]: '{path}'")
        self._items, self._name, self._path, self._assumed = cast("dict[str, Any]", section), name, path, assumed

    def read_value(self, key: str, unit: str) -> Any:
        """The value of `key`, given in `unit`; raises CalibrationError."""
        where = f"{self._name}.{key}"
        entry = self._items.get(key)
        if not isinstance(entry, dict) or not {"value", "unit", "from"} <= entry.keys():
            raise CalibrationError(f"{where} must be a table with value, unit and from: '{self._path}'")
        entry = cast("dict[str, Any]", entry)
        if entry["unit"] != unit or unit not in _UNITS:
            raise CalibrationError(f"{where} must be given in {unit!r}, got {entry['unit']!r}: '{self._path}'")
        value = entry["value"]
        numbers = cast("list[Any]", value if isinstance(value, list) else [value])
        if not all(isinstance(n, (int, float)) and not isinstance(n, bool) for n in numbers):
            raise CalibrationError(f"{where} must be a number or a list of numbers, got {value!r}: '{self._path}'")
        if not all(abs(n) <= _MAX_NUMBER for n in numbers):  # false for NaN
            raise CalibrationError(f"{where} must be finite, within {_MAX_NUMBER:g}, got {value!r}: '{self._path}'")
        if entry.get("assumed", False):
            self._assumed.append(where)
        return cast("object", value)

    def has(self, key: str) -> bool:
        """Whether the section has `key`."""
        return key in self._items

    def read_number(self, key: str, unit: str, low: float = -np.inf, high: float = np.inf) -> float:
        """A number within [low, high]; raises CalibrationError."""
        raw = self.read_value(key, unit)
        if isinstance(raw, list):
            raise CalibrationError(f"{self._name}.{key} must be one number, got {raw!r}: '{self._path}'")
        value = float(raw)
        if not low <= value <= high:
            raise CalibrationError(
                f"{self._name}.{key} must lie within {low:g} and {high:g} {unit}, got {value:g}: '{self._path}'"
            )
        return value

    def read_vector(
        self, key: str, unit: str, low: float = -np.inf, high: float = np.inf
    ) -> tuple[float, float, float]:
        """Three numbers within [low, high]; raises CalibrationError."""
        value = self.read_value(key, unit)
        if not isinstance(value, list) or len(cast("list[Any]", value)) != 3:
            raise CalibrationError(f"{self._name}.{key} must be a list of 3 numbers, got {value!r}: '{self._path}'")
        x, y, z = (float(v) for v in cast("list[Any]", value))
        if not low <= min(x, y, z) <= max(x, y, z) <= high:
            raise CalibrationError(
                f"{self._name}.{key} must lie within {low:g} and {high:g} {unit}, got {value!r}: '{self._path}'"
            )
        return x, y, z
