"""Sensor descriptions: one TOML per sensor, read and checked once.

Every number in a TOML is a table `{ value, unit, from }` with `assumed = true` where no source gives it, so that a
reader of the file sees where each figure comes from. `extends = "other"` starts from another sensor's file.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from pipeline import membrane, rigid
from pipeline.arrays import Doubles, freeze
from pipeline.camera import Camera
from pipeline.errors import CalibrationError, FileProblem, SettingProblem
from pipeline.membrane import Membrane

_FOLDER = Path(__file__).parent
_UNITS = {"px", "mm", "px/mm", "kPa", "N/mm", "1", "deg", "grey", "rgb", "grey/px", "mm^3"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Gel:
    """A bonded elastic layer."""

    thickness_mm: float
    youngs_kpa: float
    poisson: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Bubble:
    """A pre-stretched membrane over an elliptic rim, inflated with sealed air."""

    half_width_mm: float
    half_height_mm: float
    height_mm: float
    pressure_kpa: float  # gauge, untouched
    dead_volume_mm3: float  # air behind the rim plane
    depth_noise_mm: float  # standard deviation of one depth reading


@dataclass(frozen=True, slots=True, kw_only=True)
class Led:
    """A light at the gel's edge: where it stands (azimuth of the side it shines from) and what it adds."""

    azimuth_deg: float  # 0 = from the right (+x), 90 = from below (+y), in the image
    elevation_deg: float
    rgb: tuple[float, float, float]  # grey levels that a surface facing it gains


@dataclass(frozen=True, slots=True, kw_only=True)
class Glow:
    """A coloured patch of the untouched picture: a Gaussian lobe, in halves of the image from its centre."""

    x: float  # -1 = left edge, 1 = right edge
    y: float  # -1 = top edge, 1 = bottom edge
    width: float  # where the lobe has fallen to 1/e
    height: float
    rgb: tuple[float, float, float]  # grey levels at its middle


@dataclass(frozen=True, slots=True, kw_only=True)
class Optics:
    """How the gel's slope becomes colour."""

    base_rgb: tuple[float, float, float]  # untouched colour under the glows, grey levels 0..255
    leds: tuple[Led, ...]
    falloff: float  # share of an LED's light lost from its own side to the far side of the image
    vignette: float  # share of light lost in the corners
    blur_px: float
    noise_grey: float
    glows: tuple[Glow, ...] = ()
    shadow: float = 0.0  # share of an LED's light that is missing right behind a dent
    shadow_deg: float = 20.0  # how steeply that light comes in: the lower, the longer the shadow


@dataclass(frozen=True, slots=True, kw_only=True)
class Markers:
    """A grid of dark dots printed under the gel surface."""

    pitch_mm: float
    radius_mm: float
    darkness: float  # 1 = black
    twin_mm: float = 0.0  # distance, across the image, of the two halves of a doubled dot; 0 = a single dot
    jitter_mm: float = 0.0  # how far, at most and along each axis, a dot is printed off its place
    bend: float = 0.0  # share by which the lens draws the grid's corners outward; below 0 inward
    turn_deg: float = 0.0
    phase_mm: tuple[float, float] = (0.0, 0.0)  # of the dot nearest to the image centre, right and down


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What counts as a touch, and what is beyond the sensor."""

    contact_min_mm: float  # smallest indentation that counts
    indentation_max_mm: float
    no_touch: float  # largest smoothed change from the reference of an untouched frame: grey levels, or mm of a bubble


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorSpec:
    """One sensor: its camera, rest surface, mechanics, optics, limits and place in the alignment frame."""

    name: str
    title: str
    kind: Literal["gel", "bubble"]
    camera: Camera
    membrane: Membrane
    rest_depth_mm: Doubles  # (rows, cols) of `membrane` through `camera`
    alignment_from_sensor: Doubles  # (4, 4) mm
    limits: Limits
    gel: Gel | None = None
    bubble: Bubble | None = None
    optics: Optics | None = None
    markers: Markers | None = None
    assumed: tuple[str, ...] = ()  # keys whose numbers nobody has published

    @property
    def pixel_mm(self) -> float:
        """Width of one pixel on the rest surface at the optical axis."""
        return float(np.median(self.rest_depth_mm)) / self.camera.fx_px


def names() -> tuple[str, ...]:
    """The sensors that come with the project, sorted."""
    return tuple(sorted(p.stem for p in _FOLDER.glob("*.toml")))


@lru_cache(maxsize=32)
def sensor(name_or_file: str) -> SensorSpec:
    """The sensor of this name, or described by this TOML file; raises SettingProblem or CalibrationError."""
    path = Path(name_or_file)
    if path.suffix != ".toml":
        path = _FOLDER / f"{name_or_file}.toml"
        if not path.is_file():
            raise SettingProblem(
                f"unknown sensor {name_or_file!r}; known are {', '.join(names())}, or give a .toml file of your own"
            )
    return _build(path.stem, _read(path), path)


def _read(path: Path, children: tuple[Path, ...] = ()) -> dict[str, Any]:
    if path in children:
        raise FileProblem("a sensor description extends itself", path, field="extends")
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileProblem(f"cannot read the sensor description ({error.strerror})", path) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FileProblem(f"the sensor description is not valid TOML ({error})", path) from error
    parent = data.pop("extends", None)
    if parent is None:
        return data
    if not isinstance(parent, str):
        raise FileProblem("extends must be the name of a sensor", path, field="extends")
    beside = path.parent / f"{parent}.toml"
    merged = _read(beside if beside.is_file() else _FOLDER / f"{parent}.toml", (*children, path))
    for key, value in data.items():
        merged[key] = {**merged.get(key, {}), **value} if isinstance(value, dict) else value
    for key in data.get("without", ()):
        merged.pop(key, None)
    return merged


class _Section:
    """One [section] of a description; every look-up checks presence, unit and finiteness."""

    def __init__(self, data: Mapping[str, Any], name: str, path: Path, assumed: list[str]) -> None:
        section = data.get(name)
        if not isinstance(section, dict):
            raise CalibrationError(f"the sensor description lacks the section [{name}]: '{path}'")
        self._items, self._name, self._path, self._assumed = cast("dict[str, Any]", section), name, path, assumed

    def raw(self, key: str, unit: str) -> Any:
        """The value of `key`, which must be given in `unit`."""
        where = f"{self._name}.{key}"
        entry = self._items.get(key)
        if not isinstance(entry, dict) or not {"value", "unit", "from"} <= entry.keys():
            raise CalibrationError(f"{where} must be a table with value, unit and from: '{self._path}'")
        entry = cast("dict[str, Any]", entry)
        if entry["unit"] != unit or unit not in _UNITS:
            raise CalibrationError(f"{where} must be given in {unit!r}, got {entry['unit']!r}: '{self._path}'")
        try:
            finite = bool(np.isfinite(np.asarray(entry["value"], dtype=np.float64)).all())
        except (TypeError, ValueError):
            raise CalibrationError(
                f"{where} must be a number or a list of numbers, got {entry['value']!r}: '{self._path}'"
            ) from None
        if not finite:
            raise CalibrationError(f"{where} must be finite, got {entry['value']!r}: '{self._path}'")
        if entry.get("assumed", False):
            self._assumed.append(where)
        return entry["value"]

    def has(self, key: str) -> bool:
        """Whether an optional number is given."""
        return key in self._items

    def number(self, key: str, unit: str, low: float = -np.inf, high: float = np.inf) -> float:
        """A number within [low, high]."""
        raw = self.raw(key, unit)
        if isinstance(raw, list):
            raise CalibrationError(f"{self._name}.{key} must be one number, got {raw!r}: '{self._path}'")
        value = float(raw)
        if not low <= value <= high:
            raise CalibrationError(
                f"{self._name}.{key} must lie within {low:g} and {high:g} {unit}, got {value:g}: '{self._path}'"
            )
        return value

    def vector(self, key: str, unit: str, length: int = 3) -> tuple[float, ...]:
        """A list of `length` numbers."""
        value = self.raw(key, unit)
        if not isinstance(value, list) or len(cast("list[Any]", value)) != length:
            raise CalibrationError(
                f"{self._name}.{key} must be a list of {length} numbers, got {value!r}: '{self._path}'"
            )
        return tuple(float(v) for v in cast("list[Any]", value))


def _build(name: str, data: dict[str, Any], path: Path) -> SensorSpec:
    assumed: list[str] = []

    def section(key: str) -> _Section:
        return _Section(data, key, path, assumed)

    kind = data.get("kind")
    if kind not in ("gel", "bubble"):
        raise CalibrationError(f"kind must be 'gel' or 'bubble', got {kind!r}: '{path}'")
    image, lens, align = section("image"), section("camera"), section("alignment")
    rows, cols = (int(image.number(k, "px", 1, 10_000)) for k in ("rows", "cols"))
    camera = Camera(rows=rows, cols=cols, fx_px=lens.number("fx", "px"), fy_px=lens.number("fy", "px"),
                    cx_px=lens.number("cx", "px"), cy_px=lens.number("cy", "px"))  # fmt: skip
    gel, bubble, optics = None, None, None
    if kind == "gel":
        gel = _gel(section("gel"))
        z = section("rest").number("depth", "mm", 0.1, 1000.0)
        surface = membrane.flat(z, camera.cols * z / camera.fx_px, camera.rows * z / camera.fy_px)
        optics = _optics(section("optics"), data, path)
    else:
        bubble = _bubble(section("bubble"))
        surface = membrane.dome(
            section("rest").number("rim_depth", "mm", 1.0, 1000.0),
            bubble.height_mm,
            bubble.half_width_mm,
            bubble.half_height_mm,
        )
    pose = rigid.from_parts(align.vector("translation", "mm"), align.vector("rotation_vector", "deg"))
    return SensorSpec(
        name=name,
        title=str(data.get("title", name)),
        kind=kind,
        camera=camera,
        membrane=surface,
        rest_depth_mm=surface.rest_depth_mm(camera),
        alignment_from_sensor=freeze(pose),
        limits=_limits(section("limits"), "grey" if kind == "gel" else "mm"),
        gel=gel,
        bubble=bubble,
        optics=optics,
        markers=_markers(section("markers")) if "markers" in data else None,
        assumed=tuple(assumed),
    )


def _limits(s: _Section, touch_unit: str) -> Limits:
    return Limits(
        contact_min_mm=s.number("contact_min", "mm", 0.0),
        indentation_max_mm=s.number("indentation_max", "mm", 1e-3),
        no_touch=s.number("no_touch", touch_unit, 0.0),
    )


def _gel(s: _Section) -> Gel:
    return Gel(
        thickness_mm=s.number("thickness", "mm", 0.01),
        youngs_kpa=s.number("youngs", "kPa", 0.1),
        poisson=s.number("poisson", "1", 0.0, 0.5),
    )


def _bubble(s: _Section) -> Bubble:
    return Bubble(
        half_width_mm=s.number("half_width", "mm", 1.0),
        half_height_mm=s.number("half_height", "mm", 1.0),
        height_mm=s.number("height", "mm", 0.0),
        pressure_kpa=s.number("pressure", "kPa", 0.0),
        dead_volume_mm3=s.number("dead_volume", "mm^3", 0.0),
        depth_noise_mm=s.number("depth_noise", "mm", 0.0),
    )


def _optics(s: _Section, data: dict[str, Any], path: Path) -> Optics:
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
    base = s.vector("base", "rgb")
    return Optics(
        base_rgb=(base[0], base[1], base[2]),
        leds=parsed,
        glows=glows,
        falloff=s.number("falloff", "1", 0.0, 1.0),
        vignette=s.number("vignette", "1", 0.0, 1.0),
        blur_px=s.number("blur", "px", 0.0),
        noise_grey=s.number("noise", "grey", 0.0),
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
        except (KeyError, TypeError, ValueError) as error:
            raise CalibrationError(f"{told}, got {entry!r}: '{path}'") from error
        if not np.isfinite(value).all():
            raise CalibrationError(f"{told} as finite numbers, got {entry!r}: '{path}'")
        values.append(value)
    return values


def _markers(s: _Section) -> Markers:
    return Markers(
        pitch_mm=s.number("pitch", "mm", 0.1),
        radius_mm=s.number("radius", "mm", 0.0),
        darkness=s.number("darkness", "1", 0.0, 1.0),
        twin_mm=s.number("twin", "mm", 0.0) if s.has("twin") else 0.0,
        jitter_mm=s.number("jitter", "mm", 0.0) if s.has("jitter") else 0.0,
        bend=s.number("bend", "1", -0.5, 0.5) if s.has("bend") else 0.0,
    )
