"""The parts of a sensor description, each read from its section of the TOML."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

from pipeline.base.errors import CalibrationError
from pipeline.sensors.parts import Bubble, DepthCamera, Gel, Glow, Led, Limits, Markers, Optics
from pipeline.sensors.sections import Section

_LARGEST_OF_A_LIGHT = 1000.0  # degrees, halves of the image, or grey levels


def limits_in(s: Section, touch_unit: str) -> Limits:
    """[limits]; `touch_unit` is that of no_touch: grey for a gel, mm for a bubble."""
    return Limits(
        contact_min_mm=s.number("contact_min", "mm", 0.0, 100.0),
        indentation_max_mm=s.number("indentation_max", "mm", 1e-3, 100.0),
        depth_rms_mm=s.number("depth_rms", "mm", 0.0, 100.0) if s.has("depth_rms") else 0.0,
        depth_correlation_mm=s.number("depth_correlation", "mm", 1e-3, 100.0) if s.has("depth_rms") else 1.0,
        no_touch=s.number("no_touch", touch_unit, 0.0, 255.0),
    )


def gel_in(s: Section) -> Gel:
    """[gel]."""
    return Gel(
        thickness_mm=s.number("thickness", "mm", 0.01, 100.0),
        youngs_kpa=s.number("youngs", "kPa", 0.1, 1e7),
        poisson=s.number("poisson", "1", 0.0, 0.5),
    )


def bubble_in(s: Section) -> Bubble:
    """[bubble]."""
    return Bubble(
        half_width_mm=s.number("half_width", "mm", 1.0, 500.0),
        half_height_mm=s.number("half_height", "mm", 1.0, 500.0),
        height_mm=s.number("height", "mm", 0.0, 500.0),
        pressure_kpa=s.number("pressure", "kPa", 0.0, 100.0),
        dead_volume_mm3=s.number("dead_volume", "mm^3", 0.0, 1e7),
        depth_noise_mm=s.number("depth_noise", "mm", 0.0, 50.0),
    )


def depth_camera_in(s: Section) -> DepthCamera:
    """[depth_camera]; what it does not say is as time of flight has it."""
    usual = DepthCamera()

    def number(key: str, unit: str, otherwise: float, high: float) -> float:
        return s.number(key, unit, 0.0, high) if s.has(key) else otherwise

    return DepthCamera(
        distance_power=number("distance_power", "1", usual.distance_power, 8.0),
        grazing_power=number("grazing_power", "1", usual.grazing_power, 8.0),
        grain_px=number("grain", "px", usual.grain_px, 20.0),
        jump_mm=number("jump", "mm", usual.jump_mm, 1000.0),
        flying_share=number("flying_share", "1", usual.flying_share, 1.0),
        steepest_deg=number("steepest", "deg", usual.steepest_deg, 90.0),
        gap_share=number("gap_share", "1", usual.gap_share, 1.0),
        step_mm=number("step", "mm", usual.step_mm, 100.0),
    )


def optics_in(s: Section, data: dict[str, Any], path: Path) -> Optics:
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
    base = s.vector("base", "rgb", 0.0, 255.0)
    return Optics(
        base_rgb=base,
        leds=parsed,
        glows=glows,
        falloff=s.number("falloff", "1", 0.0, 1.0),
        vignette=s.number("vignette", "1", 0.0, 1.0),
        blur_px=s.number("blur", "px", 0.0, 100.0),
        noise_grey=s.number("noise", "grey", 0.0, 255.0),
        shadow=s.number("shadow", "1", 0.0, 1.0) if s.has("shadow") else 0.0,
        shadow_deg=s.number("shadow_elevation", "deg", 1.0, 89.0) if s.has("shadow_elevation") else 20.0,
    )


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


def markers_in(s: Section) -> Markers:
    """[markers]."""
    return Markers(
        pitch_mm=s.number("pitch", "mm", 0.1, 100.0),
        radius_mm=s.number("radius", "mm", 0.0, 50.0),
        darkness=s.number("darkness", "1", 0.0, 1.0),
        twin_mm=s.number("twin", "mm", 0.0, 50.0) if s.has("twin") else 0.0,
        jitter_mm=s.number("jitter", "mm", 0.0, 50.0) if s.has("jitter") else 0.0,
        bend=s.number("bend", "1", -0.5, 0.5) if s.has("bend") else 0.0,
    )
