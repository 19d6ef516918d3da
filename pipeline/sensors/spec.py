"""Sensor descriptions: one TOML per sensor, read and checked once.

Every number in a TOML is a table `{ value, unit, from }` with `assumed = true` where no source
gives it. `extends = "other"` starts from another sensor's file.
"""

from __future__ import annotations

import math
from dataclasses import field, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.derived import DERIVED, derive_once
from pipeline.core.digests import UNDIGESTED
from pipeline.core.errors import CalibrationError, SettingProblem, TouchError
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import MOST_FOCAL_PX, WIDEST_VIEW, Camera
from pipeline.core.geometry.membrane import Membrane
from pipeline.sensors import descriptions
from pipeline.sensors.descriptions import (
    DescriptionSection,
    find_descriptions,
    read_description,
)
from pipeline.sensors.kinds import SensorKind, get_kind, list_kinds
from pipeline.sensors.parts import (
    Bubble,
    DepthCamera,
    Gel,
    Markers,
    Optics,
    SensorLimits,
    parse_limits,
    parse_part,
)


@frozen
class SensorSpec:
    """One sensor: its camera, rest surface, mechanics, optics, limits and place in the alignment
    frame.
    """

    name: str
    title: str
    kind: str  # key of `sensor_kind`
    camera: Camera
    membrane: Membrane
    rest_depth_mm: Doubles  # (rows, cols) of `membrane` through `camera`
    alignment_from_sensor: Doubles  # (4, 4) mm
    limits: SensorLimits
    gel: Gel | None = None
    bubble: Bubble | None = None
    depth_camera: DepthCamera | None = None  # of a bubble
    optics: Optics | None = None
    markers: Markers | None = None
    assumed_keys: tuple[str, ...] = ()  # keys of numbers without a published source
    # Width of one pixel on the rest surface at the optical axis, by the median depth; computed
    # once.
    pixel_mm: float = field(init=False, repr=False, compare=False, metadata=UNDIGESTED)

    def __post_init__(self) -> None:
        """Compute the pixel width."""
        object.__setattr__(
            self, "pixel_mm", float(np.median(self.rest_depth_mm)) / self.camera.fx_px
        )

    @property
    def sensor_kind(self) -> SensorKind:
        """What the pipeline does differently for this kind of sensor."""
        return get_kind(self.kind)

    def with_camera(self, camera: Camera) -> SensorSpec:
        """Copy with another camera; membrane, frame and limits stay. The last few are cached.

        Raises CalibrationError for a camera whose rays miss the membrane.
        """
        if camera == self.camera:
            return self
        return _replace_camera(self, camera)


_SIDES_PX = (8, 10_000)  # range of an image side; smaller images show no slope and no edge
# beside sections that a kind reads
_OPTIONAL_KEYS = ("title", "kind", "without", "rest", "markers", "depth_camera")


@derive_once
def _replace_camera(sensor: SensorSpec, camera: Camera) -> SensorSpec:
    return replace(sensor, camera=camera, rest_depth_mm=sensor.membrane.rest_depth_mm(camera))


def list_sensor_names() -> tuple[str, ...]:
    """The names of all described sensors, sorted."""
    return tuple(sorted(find_descriptions()))


def list_sensor_titles() -> dict[str, str]:
    """Name -> title of all described sensors, sorted by name.

    One whose description cannot be read has its name.
    """
    titles: dict[str, str] = {}
    for name, path in sorted(find_descriptions().items()):
        try:
            titles[name] = str(read_description(path).get("title", name))
        except TouchError:
            titles[name] = name
    return titles


def load_sensor(name_or_file: str) -> SensorSpec:
    """The sensor of this name or TOML file; the same object until the file changes.

    Raises SettingProblem for an unknown name, CalibrationError or FileProblem for an invalid
    description.
    """
    path = Path(name_or_file)
    if path.suffix != ".toml":
        known = find_descriptions()
        if name_or_file not in known:
            raise SettingProblem(
                f"unknown sensor {name_or_file!r}; known are {', '.join(sorted(known))}; or give "
                "a .toml file"
            )
        path = known[name_or_file]
    data = read_description(path)
    key = load_sensor, path, repr(data)
    return DERIVED.get_or_make(key, lambda: (_build(path.stem, data, path),))[0]


def _build(name: str, data: dict[str, Any], path: Path) -> SensorSpec:
    assumed: list[str] = []
    sections: dict[str, DescriptionSection] = {}

    def section(key: str) -> DescriptionSection:
        return sections.setdefault(key, DescriptionSection(data, key, path, assumed))

    kinds = list_kinds()
    key = data.get("kind")
    if not isinstance(key, str) or key not in kinds:
        raise CalibrationError(
            f"kind must be {' or '.join(map(repr, sorted(kinds)))}, got {key!r}: '{path}'"
        )
    kind = kinds[key]
    image = section("image")
    lens = section("camera")
    align = section("alignment")
    sides_px = [image.read_number(k, "px", *_SIDES_PX) for k in ("rows", "cols")]
    rows, cols = map(int, sides_px)
    if [rows, cols] != sides_px:
        raise CalibrationError(
            "image.rows and image.cols must be whole numbers, got {:g} and {:g}: '{}'".format(
                *sides_px, path
            )
        )
    least_px = max(rows, cols) / WIDEST_VIEW
    fx_px, fy_px = (lens.read_number(k, "px", least_px, MOST_FOCAL_PX) for k in ("fx", "fy"))
    cx_px, cy_px = (lens.read_number(k, "px", -MOST_FOCAL_PX, MOST_FOCAL_PX) for k in ("cx", "cy"))
    camera = Camera(rows=rows, cols=cols, fx_px=fx_px, fy_px=fy_px, cx_px=cx_px, cy_px=cy_px)
    parts = kind.parse_parts(section, data, path)
    surface = kind.parse_membrane(section, camera, parts)
    shift_mm = align.read_vector(
        "translation", "mm", -rigid.MAX_TRANSLATION_MM, rigid.MAX_TRANSLATION_MM
    )
    pose = rigid.from_parts(shift_mm, align.read_vector("rotation_vector", "deg", -360.0, 360.0))
    limits = parse_limits(section("limits"), kind.change_unit)
    markers = parse_part(Markers, section("markers")) if "markers" in data else None
    descriptions.refuse_unknown_keys(data, {*sections, *_OPTIONAL_KEYS}, path)
    for key, read in sections.items():
        descriptions.refuse_unknown_keys(data[key], read.known_keys, path, f"{key}.")
    return SensorSpec(
        name=name,
        title=str(data.get("title", name)),
        kind=kind.key,
        camera=camera,
        membrane=surface,
        rest_depth_mm=surface.rest_depth_mm(camera),
        alignment_from_sensor=freeze(pose),
        limits=limits,
        markers=markers,
        assumed_keys=tuple(assumed),
        **parts,
    )


_MAX_RATIO = 3.0  # between two cameras of one kind of sensor; a factor of ten is a unit
_FACTORS = (0.001, 0.01, 0.1, 10.0, 100.0, 1000.0)


def find_unit_factor(depth_mm: float, spec: SensorSpec) -> float:
    """The factor that a median depth lacks to fit the sensor's rest depth: 1 where it fits, NaN
    where no unit does.
    """
    rest_mm = float(np.median(spec.rest_depth_mm))
    if not depth_mm > 0.0:
        return math.nan
    distances = {factor: abs(math.log(depth_mm * factor / rest_mm)) for factor in (1.0, *_FACTORS)}
    factor = (
        1.0
        if distances[1.0] <= math.log(_MAX_RATIO)
        else min(distances, key=lambda f: distances[f])
    )
    return factor if distances[factor] <= math.log(_MAX_RATIO) else math.nan


def describe_unit_problem(depth_mm: float, spec: SensorSpec) -> str:
    """Why a median depth cannot be in millimetres, as a clause; "" where it may be."""
    factor = find_unit_factor(depth_mm, spec)
    if factor == 1.0 or math.isnan(factor):
        return ""
    times = f"{1 / factor:g} times too large" if factor < 1 else f"{factor:g} times too small"
    return (
        f"has a median depth of {depth_mm:.3g} mm, and the membrane of {spec.name} rests at "
        f"{np.median(spec.rest_depth_mm):.3g} mm: {times}, so its unit is another one"
    )
