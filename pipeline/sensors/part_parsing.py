"""Parse the parts of a sensor description from sections of its TOML."""

from __future__ import annotations

from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, TypeVar, cast

from pipeline.base.errors import CalibrationError
from pipeline.sensors.descriptions import DescriptionSection
from pipeline.sensors.parts import Glow, Led, NumberRange, Optics, SensorLimits

T = TypeVar("T")

_MAX_LIGHT_NUMBER = 1000.0  # degrees, half image sizes, or grey levels


def parse_part(kind: type[T], s: DescriptionSection) -> T:
    """A part that has only numbers; raises CalibrationError."""
    return kind(**parse_numbers(kind, s))


def parse_numbers(kind: type[Any], s: DescriptionSection) -> dict[str, float]:
    """Field name -> value of the numbers in a section, checked by each field's `NumberRange`."""
    values: dict[str, float] = {}
    for f in fields(kind):
        number: NumberRange | None = f.metadata.get("number")
        if number is not None:
            key = number.key or f.name.removesuffix(f"_{number.unit.lower().replace('^', '')}")
            if f.default is MISSING or s.has(key):
                values[f.name] = s.read_number(key, number.unit, number.low, number.high)
    return values


def parse_limits(s: DescriptionSection, change_unit: str) -> SensorLimits:
    """[limits]; `change_unit` is the unit of `no_contact_change`, grey or mm."""
    values = parse_numbers(SensorLimits, s)
    if "depth_rms_mm" in values:
        values["depth_correlation_mm"] = s.read_number("depth_correlation", "mm", 1e-3, 100.0)
    return SensorLimits(**values, no_contact_change=s.read_number("no_contact_change", change_unit, 0.0, 255.0))


def parse_optics(s: DescriptionSection, data: dict[str, Any], path: Path) -> Optics:
    """[optics] with the lists of LEDs and glows in the description `data`."""
    leds = tuple(
        Led(azimuth_deg=v[0], elevation_deg=v[1], rgb=(v[2], v[3], v[4]))
        for v in _parse_lights(data, "leds", ("azimuth_deg", "elevation_deg"), path)
    )
    if not leds:
        raise CalibrationError(f"optics.leds must list at least one LED: '{path}'")
    glows = tuple(
        Glow(x=v[0], y=v[1], width=v[2], height=v[3], rgb=(v[4], v[5], v[6]))
        for v in _parse_lights(data, "glows", ("x", "y", "width", "height"), path)
    )
    if any(g.width <= 0 or g.height <= 0 for g in glows):
        raise CalibrationError(f"optics.glows must have a positive width and height: '{path}'")
    base = s.read_vector("base", "rgb", 0.0, 255.0)
    return Optics(base_rgb=base, leds=leds, glows=glows, **parse_numbers(Optics, s))


def _parse_lights(data: dict[str, Any], key: str, numbers: tuple[str, ...], path: Path) -> list[tuple[float, ...]]:
    """The `numbers`, then r, g, b of every entry of the list optics.`key`; raises CalibrationError."""
    entries = data["optics"].get(key, [])
    requirement = f"each of optics.{key} needs {', '.join(numbers)} and rgb"
    if not isinstance(entries, list):
        raise CalibrationError(f"{requirement}, got {entries!r}: '{path}'")
    values: list[tuple[float, ...]] = []
    for entry in cast("list[dict[str, Any]]", entries):
        try:
            r, g, b = (float(v) for v in entry["rgb"])
            value = (*(float(entry[name]) for name in numbers), r, g, b)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise CalibrationError(f"{requirement}, got {entry!r}: '{path}'") from error
        if not all(abs(v) <= _MAX_LIGHT_NUMBER for v in value):  # false for NaN
            raise CalibrationError(f"{requirement} within {_MAX_LIGHT_NUMBER:g}, got {entry!r}: '{path}'")
        values.append(value)
    return values
