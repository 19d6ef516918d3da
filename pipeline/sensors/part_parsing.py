"""The parts of a sensor description, each read from its section of the TOML."""

from __future__ import annotations

from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, TypeVar, cast

from pipeline.base.errors import CalibrationError
from pipeline.sensors.descriptions import DescriptionSection
from pipeline.sensors.parts import Glow, Led, NumberRange, Optics, SensorLimits

T = TypeVar("T")

_LARGEST_OF_A_LIGHT = 1000.0  # degrees, halves of the image, or grey levels


def parse_part(kind: type[T], s: DescriptionSection) -> T:
    """A part of a sensor that is all numbers."""
    return kind(**parse_numbers(kind, s))


def parse_numbers(kind: type[Any], s: DescriptionSection) -> dict[str, float]:
    """The numbers of a part that its section gives, each as its field's `told` says."""
    found: dict[str, float] = {}
    for f in fields(kind):
        told: NumberRange | None = f.metadata.get("number")
        if told is not None:
            key = told.key or f.name.removesuffix(f"_{told.unit.lower().replace('^', '')}")
            if f.default is MISSING or s.has(key):
                found[f.name] = s.read_number(key, told.unit, told.low, told.high)
    return found


def parse_limits(s: DescriptionSection, touch_unit: str) -> SensorLimits:
    """[limits]; `touch_unit` is that of no_touch: grey for a gel, mm for a bubble."""
    found = parse_numbers(SensorLimits, s)
    if "depth_rms_mm" in found:
        found["depth_correlation_mm"] = s.read_number("depth_correlation", "mm", 1e-3, 100.0)
    return SensorLimits(**found, no_contact_change=s.read_number("no_contact_change", touch_unit, 0.0, 255.0))


def parse_optics(s: DescriptionSection, data: dict[str, Any], path: Path) -> Optics:
    """[optics] with its lists of LEDs and glows, which come from the whole description `data`."""
    parsed = tuple(
        Led(azimuth_deg=v[0], elevation_deg=v[1], rgb=(v[2], v[3], v[4]))
        for v in _lights(data, "leds", ("azimuth_deg", "elevation_deg"), path)
    )
    if not parsed:
        raise CalibrationError(f"optics.leds must list at least one LED: '{path}'")
    glows = tuple(
        Glow(x=v[0], y=v[1], width=v[2], height=v[3], rgb=(v[4], v[5], v[6]))
        for v in _lights(data, "glows", ("x", "y", "width", "height"), path)
    )
    if any(g.width <= 0 or g.height <= 0 for g in glows):
        raise CalibrationError(f"optics.glows must have a positive width and height: '{path}'")
    base = s.read_vector("base", "rgb", 0.0, 255.0)
    return Optics(base_rgb=base, leds=parsed, glows=glows, **parse_numbers(Optics, s))


def _lights(data: dict[str, Any], key: str, numbers: tuple[str, ...], path: Path) -> list[tuple[float, ...]]:
    """The list optics.`key`: of every entry its `numbers`, then r, g, b."""
    entries = data["optics"].get(key, [])
    told = f"each of optics.{key} needs {', '.join(numbers)} and rgb"
    if not isinstance(entries, list):
        raise CalibrationError(f"{told}, got {entries!r}: '{path}'")
    values: list[tuple[float, ...]] = []
    for entry in cast("list[dict[str, Any]]", entries):
        try:
            r, g, b = (float(v) for v in entry["rgb"])
            value = (*(float(entry[name]) for name in numbers), r, g, b)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise CalibrationError(f"{told}, got {entry!r}: '{path}'") from error
        if not all(abs(v) <= _LARGEST_OF_A_LIGHT for v in value):  # NaN is within nothing
            raise CalibrationError(f"{told} within {_LARGEST_OF_A_LIGHT:g}, got {entry!r}: '{path}'")
        values.append(value)
    return values
