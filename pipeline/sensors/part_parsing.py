"""Parse the parts of a sensor description from sections of its TOML."""

from dataclasses import MISSING, fields
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta

from pipeline.base.typed_data import convert
from pipeline.sensors.descriptions import DESCRIPTION, DescriptionSection
from pipeline.sensors.parts import Glow, Led, NumberRange, Optics, SensorLimits

T = TypeVar("T")


class _Lights(msgspec.Struct, kw_only=True, frozen=True):
    """The lists of [optics]."""

    leds: Annotated[tuple[Led, ...], Meta(min_length=1)]
    glows: tuple[Glow, ...] = ()


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
    lights = convert(data["optics"], _Lights, DESCRIPTION, path, within="optics")
    base = s.read_vector("base", "rgb", 0.0, 255.0)
    return Optics(base_rgb=base, leds=lights.leds, glows=lights.glows, **parse_numbers(Optics, s))
