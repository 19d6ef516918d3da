"""Sensor descriptions: one TOML per sensor, read and checked once.

Every number in a TOML is a table `{ value, unit, from }` with `assumed = true` where no source gives it, so that a
reader of the file sees where each figure comes from. `extends = "other"` starts from another sensor's file.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pipeline.base.arrays import Doubles, freeze
from pipeline.base.errors import CalibrationError, SettingProblem
from pipeline.base.memo import Memo
from pipeline.engine.digests import UNDIGESTED, content
from pipeline.geometry import membrane, rigid
from pipeline.geometry.camera import Camera
from pipeline.geometry.membrane import Membrane
from pipeline.sensors.descriptions import DescriptionSection, find_descriptions, read_description
from pipeline.sensors.part_parsing import parse_limits, parse_optics, parse_part
from pipeline.sensors.parts import Bubble, DepthCamera, Gel, Markers, Optics, SensorLimits
from pipeline.sensors.rest_mesh import load_rest_membrane


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
    limits: SensorLimits
    gel: Gel | None = None
    bubble: Bubble | None = None
    depth_camera: DepthCamera | None = None  # of a bubble
    optics: Optics | None = None
    markers: Markers | None = None
    assumed_keys: tuple[str, ...] = ()  # keys whose numbers nobody has published
    # Width of one pixel on the rest surface at the optical axis: asked for often, and a median of all pixels.
    pixel_mm: float = field(init=False, repr=False, compare=False, metadata=UNDIGESTED)

    def __post_init__(self) -> None:
        """Work out how wide a pixel is, once."""
        object.__setattr__(self, "pixel_mm", float(np.median(self.rest_depth_mm)) / self.camera.fx_px)

    def with_camera(self, camera: Camera) -> SensorSpec:
        """The same sensor watched by another camera: membrane, frame and limits stay; the last few are kept.

        Raises CalibrationError for a camera whose rays do not meet the membrane.
        """
        if camera == self.camera:
            return self
        return _views.of(
            (content(self), camera),
            lambda: replace(self, camera=camera, rest_depth_mm=self.membrane.rest_depth_mm(camera)),
        )


_SIDES_PX = (8, 10_000)  # of an image: below, no slope and no edge can be told
_FOCAL_PX = 1e5  # a pixel that sees a hundredth of a millimetre a metre away

_views: Memo[tuple[str, Camera], SensorSpec] = Memo(32)
_read: Memo[tuple[Path, str, str], SensorSpec] = Memo(32)


def list_sensor_names() -> tuple[str, ...]:
    """The names of all described sensors, sorted."""
    return tuple(sorted(find_descriptions()))


def load_sensor(name_or_file: str) -> SensorSpec:
    """The sensor of this name or TOML file; the same object until the file changes.

    Raises SettingProblem for an unknown name, CalibrationError, FileProblem or MeshProblem for an invalid description.
    """
    path = Path(name_or_file)
    if path.suffix != ".toml":
        known = find_descriptions()
        if name_or_file not in known:
            raise SettingProblem(
                f"unknown sensor {name_or_file!r}; known are {', '.join(sorted(known))}; or give a .toml file"
            )
        path = known[name_or_file]
    data = read_description(path)
    surface = load_rest_membrane(data, path)
    return _read.of((path, repr(data), content(surface)), lambda: _build(path.stem, data, path, surface))


def _build(name: str, data: dict[str, Any], path: Path, surface: Membrane | None) -> SensorSpec:
    assumed: list[str] = []

    def section(key: str) -> DescriptionSection:
        return DescriptionSection(data, key, path, assumed)

    kind = data.get("kind")
    if kind not in ("gel", "bubble"):
        raise CalibrationError(f"kind must be 'gel' or 'bubble', got {kind!r}: '{path}'")
    image, lens, align = section("image"), section("camera"), section("alignment")
    rows, cols = (int(image.read_number(k, "px", *_SIDES_PX)) for k in ("rows", "cols"))
    fx_px, fy_px = (lens.read_number(k, "px", 1.0, _FOCAL_PX) for k in ("fx", "fy"))
    cx_px, cy_px = (lens.read_number(k, "px", -_FOCAL_PX, _FOCAL_PX) for k in ("cx", "cy"))
    camera = Camera(rows=rows, cols=cols, fx_px=fx_px, fy_px=fy_px, cx_px=cx_px, cy_px=cy_px)
    gel, bubble, eye, optics = None, None, None, None
    if kind == "gel":
        gel = parse_part(Gel, section("gel"))
        if surface is None:
            z = section("rest").read_number("depth", "mm", 0.1, 1000.0)
            surface = membrane.make_flat_membrane(z, camera.cols * z / camera.fx_px, camera.rows * z / camera.fy_px)
        optics = parse_optics(section("optics"), data, path)
    else:
        bubble = parse_part(Bubble, section("bubble"))
        eye = parse_part(DepthCamera, section("depth_camera")) if "depth_camera" in data else DepthCamera()
        if surface is None:
            surface = membrane.make_dome(
                section("rest").read_number("rim_depth", "mm", 1.0, 1000.0),
                bubble.height_mm,
                bubble.half_width_mm,
                bubble.half_height_mm,
            )
    shift_mm = align.read_vector("translation", "mm", -rigid.FARTHEST_MM, rigid.FARTHEST_MM)
    pose = rigid.from_parts(shift_mm, align.read_vector("rotation_vector", "deg", -360.0, 360.0))
    return SensorSpec(
        name=name,
        title=str(data.get("title", name)),
        kind=kind,
        camera=camera,
        membrane=surface,
        rest_depth_mm=surface.rest_depth_mm(camera),
        alignment_from_sensor=freeze(pose),
        limits=parse_limits(section("limits"), "grey" if kind == "gel" else "mm"),
        gel=gel,
        bubble=bubble,
        depth_camera=eye,
        optics=optics,
        markers=parse_part(Markers, section("markers")) if "markers" in data else None,
        assumed_keys=tuple(assumed),
    )
