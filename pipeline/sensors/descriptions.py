"""Reads the TOML of a sensor and hands out its numbers, each checked for presence, unit, range and finiteness.

Every number is a table `{ value, unit, from }` with `assumed = true` where no source gives it.
`extends = "other"` starts from another sensor's file.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np

from pipeline.base.errors import CalibrationError, FileProblem
from pipeline.base.files import read_toml

DESCRIPTIONS_FOLDER = Path(__file__).parent  # where the project's own descriptions lie
_LARGEST = 1e9  # of any number of a description: float32 holds what follows from it
_UNITS = {"px", "mm", "px/mm", "kPa", "N/mm", "1", "deg", "grey", "rgb", "grey/px", "mm^3"}


def read_description(path: Path, children: tuple[Path, ...] = ()) -> dict[str, Any]:
    """The sections of a description merged over those it extends; raises FileProblem.

    `children` are the files that extend this one, so that a circle is noticed.
    """
    if path in children:
        raise FileProblem("a sensor description extends itself", path, field="extends")
    data = read_toml(path, "the sensor description")
    parent = data.pop("extends", None)
    if parent is None:
        return data
    if not isinstance(parent, str):
        raise FileProblem("extends must be the name of a sensor", path, field="extends")
    beside = path.parent / f"{parent}.toml"
    merged = read_description(beside if beside.is_file() else DESCRIPTIONS_FOLDER / f"{parent}.toml", (*children, path))
    for key, value in data.items():
        before = merged.get(key)
        merged[key] = {**before, **value} if isinstance(before, dict) and isinstance(value, dict) else value
    without = data.get("without", [])
    if not isinstance(without, list):
        raise FileProblem("without must be a list of sections", path, field="without")
    return {key: value for key, value in merged.items() if key not in without}


class DescriptionSection:
    """One [section] of a description; every look-up checks presence, unit and finiteness."""

    def __init__(self, data: Mapping[str, Any], name: str, path: Path, assumed: list[str]) -> None:
        section = data.get(name)
        if not isinstance(section, dict):
            raise CalibrationError(f"the sensor description lacks the section [{name}]: '{path}'")
        self._items, self._name, self._path, self._assumed = cast("dict[str, Any]", section), name, path, assumed

    def read_value(self, key: str, unit: str) -> Any:
        """The value of `key`, which must be given in `unit`."""
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
        if not all(abs(n) <= _LARGEST for n in numbers):  # NaN is within nothing
            raise CalibrationError(f"{where} must be finite, within {_LARGEST:g}, got {value!r}: '{self._path}'")
        if entry.get("assumed", False):
            self._assumed.append(where)
        return cast("object", value)

    def has(self, key: str) -> bool:
        """Whether an optional number is given."""
        return key in self._items

    def read_number(self, key: str, unit: str, low: float = -np.inf, high: float = np.inf) -> float:
        """A number within [low, high]."""
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
        """A list of three numbers within [low, high]."""
        value = self.read_value(key, unit)
        if not isinstance(value, list) or len(cast("list[Any]", value)) != 3:
            raise CalibrationError(f"{self._name}.{key} must be a list of 3 numbers, got {value!r}: '{self._path}'")
        x, y, z = (float(v) for v in cast("list[Any]", value))
        if not low <= min(x, y, z) <= max(x, y, z) <= high:
            raise CalibrationError(
                f"{self._name}.{key} must lie within {low:g} and {high:g} {unit}, got {value!r}: '{self._path}'"
            )
        return x, y, z
