"""One line cut through every slot: what each has for a height along it, in millimetres on the source's gel.

The line lies on the source's untouched surface, taken as flat: there it is straight and as long as it says. It is
carried over to the target as the touch is, and a camera sees a straight line as a straight line.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.base.arrays import Doubles, Mask, freeze
from pipeline.geometry import rigid
from pipeline.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.previews.preview import PixelPositions, Preview
from pipeline.sensors.offsets import Offsets
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.stage import GroundTruth, SensorRole
from pipeline.translation.pixel_trace import SOURCE
from pipeline.translation.translate import Translation
from pipeline.values.frames import Truth
from pipeline.values.results import DepthMap

NO_OFFSETS = Offsets()
N_SAMPLES = 257  # along a line: finer than the pixels of any sensor that is described
_HEIGHTS = "+ toward camera"  # how the quantities end that are heights over the untouched surface


@dataclass(frozen=True, slots=True, kw_only=True)
class SectionLine:
    """From where to where, (x, y) mm from the source camera's axis on the gel's plane."""

    begin_mm: tuple[float, float]
    end_mm: tuple[float, float]

    @property
    def length_mm(self) -> float:
        """How long it is."""
        return math.dist(self.begin_mm, self.end_mm)

    @property
    def plain(self) -> list[float]:
        """As a session file keeps it: x, y of the beginning, then of the end."""
        return [*self.begin_mm, *self.end_mm]

    def points_mm(self, count: int = N_SAMPLES) -> Doubles:
        """Points (count, 2) at equal distances, both ends among them."""
        return np.linspace(self.begin_mm, self.end_mm, count)


@dataclass(frozen=True, slots=True, kw_only=True)
class SectionPlane:
    """The plane of the line as one camera sees it; pixel centres are integers."""

    camera: Camera
    plane_z_mm: float  # z of the plane in the source's frame
    camera_from_source: Doubles | None = (
        None  # (4, 4) the camera's frame from the source's; None = it is the source's own
    )

    def project_to_px(self, points_mm: ArrayLike) -> Doubles:
        """Where the camera sees points (n, 2) of the plane, (n, 2) x, y; NaN behind the lens."""
        flat = np.asarray(points_mm, dtype=np.float64)
        points = np.column_stack([flat, np.full(len(flat), self.plane_z_mm)])
        if self.camera_from_source is not None:
            points = rigid.apply(self.camera_from_source, points)
        x_px, y_px, _ = self.camera.project(points)
        found = np.column_stack([x_px, y_px])
        found[points[:, 2] <= MIN_DEPTH_MM] = np.nan
        return found

    def backproject_to_mm(self, x_px: float, y_px: float) -> tuple[float, float]:
        """The point of the plane that is seen at a place of the picture; NaN where the plane is seen edge on."""
        camera = self.camera
        ray = np.array([(x_px - camera.cx_px) / camera.fx_px, (y_px - camera.cy_px) / camera.fy_px, 1.0])
        eye = np.zeros(3)
        if self.camera_from_source is not None:
            back = rigid.invert(self.camera_from_source)
            eye, ray = back[:3, 3], back[:3, :3] @ ray
        if abs(ray[2]) < 1e-9:
            return math.nan, math.nan
        x, y, _ = eye + (self.plane_z_mm - eye[2]) / ray[2] * ray
        return float(x), float(y)


@dataclass(frozen=True, slots=True, kw_only=True)
class HeightMap:
    """What is cut: a height for each pixel of a picture."""

    name: str  # a slot, "source", "true_source" or "true_target"
    title: str
    place: SensorRole  # whose untouched surface the heights are over
    heights_mm: NDArray[np.floating]  # (rows, cols) + toward the camera, NaN = no value
    plane: SectionPlane
    contact: Mask | None = None  # (rows, cols)


@dataclass(frozen=True, slots=True, kw_only=True)
class HeightProfile:
    """The heights of one field along the line."""

    name: str
    title: str
    place: SensorRole
    heights_mm: Doubles  # (n,), NaN = no value, or outside the picture
    contact_edges_mm: tuple[float, ...] = ()  # along the line, where its contact begins or ends


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossSection:
    """All fields along one line."""

    line: SectionLine
    along_mm: Doubles  # (n,) from the line's beginning
    profiles: tuple[HeightProfile, ...]


def sample_bilinear(values: NDArray[np.floating], px: Doubles) -> Doubles:
    """Values (rows, cols) between their pixels at x, y (n, 2), bilinear (n,).

    NaN outside the picture, and wherever one of the four pixels that count has no value.
    """
    rows, cols = values.shape
    x, y = px[:, 0], px[:, 1]
    inside = (x >= 0) & (x <= cols - 1) & (y >= 0) & (y <= rows - 1)  # never where a coordinate is NaN
    x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
    left, top = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
    over, down = x - left, y - top
    found = np.zeros(len(px))
    for row, tall in ((top, 1.0 - down), (np.minimum(top + 1, rows - 1), down)):
        for col, wide in ((left, 1.0 - over), (np.minimum(left + 1, cols - 1), over)):
            share = tall * wide
            found += np.where(share > 0, share * values[row, col], 0.0)
    return np.where(inside, found, np.nan)


def cut_section(line: SectionLine, fields: Sequence[HeightMap], count: int = N_SAMPLES) -> CrossSection:
    """Every field along the line, at `count` places."""
    points = line.points_mm(count)
    along = np.linspace(0.0, line.length_mm, count)
    return CrossSection(line=line, along_mm=freeze(along), profiles=tuple(_profile(f, points, along) for f in fields))


def _profile(field: HeightMap, points_mm: Doubles, along_mm: Doubles) -> HeightProfile:
    px = field.plane.project_to_px(points_mm)
    edges: tuple[float, ...] = ()
    if field.contact is not None:
        turns = np.flatnonzero(np.diff(np.nan_to_num(sample_bilinear(field.contact.astype(np.float32), px)) >= 0.5))
        edges = tuple(float(mm) for mm in 0.5 * (along_mm[turns] + along_mm[turns + 1]))
    return HeightProfile(
        name=field.name, title=field.title, place=field.place, contact_edges_mm=edges,
        heights_mm=freeze(sample_bilinear(field.heights_mm, px)),
    )  # fmt: skip


def build_plane(
    translation: Translation, place: SensorRole, camera: Camera, moved: Offsets = NO_OFFSETS
) -> SectionPlane:
    """The plane of the line as a camera of the source or of the target sees it, the alignment `moved` since."""
    rest = translation.source.rest_depth_mm
    return SectionPlane(
        camera=camera, plane_z_mm=float(rest[rest.shape[0] // 2, rest.shape[1] // 2]),
        camera_from_source=None if place == "source" else moved.apply_to(translation.alignment).target_from_source,
    )  # fmt: skip


def find_image_camera(picture: Preview, sensor: SensorSpec) -> Camera:
    """The camera whose pixels are the picture's."""
    shape = picture.pixels.shape[0], picture.pixels.shape[1]
    laid = picture.positions_mm
    known = laid.camera if isinstance(laid, PixelPositions) else picture.camera
    return known if known is not None and known.shape == shape else sensor.camera.resize(*shape)


def build_height_map(
    name: str, title: str, place: SensorRole, value: object, picture: Preview, sheet: SectionPlane
) -> HeightMap | None:
    """A slot's heights: of the membrane that its value has, else those that its picture shows; None without any."""
    membrane = getattr(value, "membrane", None)
    if isinstance(membrane, DepthMap):
        beneath = SectionPlane(
            camera=membrane.camera, plane_z_mm=sheet.plane_z_mm, camera_from_source=sheet.camera_from_source
        )
        return HeightMap(
            name=name, title=title, place=place, heights_mm=membrane.indentation_mm, plane=beneath,
            contact=membrane.contact,
        )  # fmt: skip
    if picture.values is None or picture.scale is None or picture.scale.unit != "mm":
        return None
    if not picture.scale.quantity.endswith(_HEIGHTS):
        return None
    contact: Mask | None = getattr(value, "contact", None)
    if contact is not None and contact.shape != picture.values.shape:
        contact = None
    return HeightMap(name=name, title=title, place=place, heights_mm=picture.values, plane=sheet, contact=contact)


def collect_height_maps(
    translation: Translation,
    facts: GroundTruth | None,
    shown: Iterable[tuple[str, Preview, object]],
    moved: Offsets = NO_OFFSETS,
) -> tuple[HeightMap, ...]:
    """What is known to be true, then whatever has heights of (a slot or "source", its picture, its value)."""
    found = [] if facts is None else list(build_true_height_maps(facts, translation, moved))
    for name, picture, value in shown:
        slot = None if name == SOURCE else translation.catalogue.stage(name)
        place: SensorRole = "source" if slot is None else slot.sensor_role
        camera = find_image_camera(picture, translation.source if place == "source" else translation.target)
        title = "Source" if slot is None else slot.title
        field = build_height_map(name, title, place, value, picture, build_plane(translation, place, camera, moved))
        found += [] if field is None else [field]
    return tuple(found)


def build_true_height_maps(
    facts: GroundTruth, translation: Translation, moved: Offsets = NO_OFFSETS
) -> tuple[HeightMap, ...]:
    """What is known to be true on either side, where it is."""
    found: list[HeightMap] = []
    sides: tuple[tuple[SensorRole, Truth | None, SensorSpec], ...] = (
        ("source", facts.source_truth, translation.source), ("target", facts.target_truth, translation.target),
    )  # fmt: skip
    for place, truth, sensor in sides:
        if truth is None or truth.indentation_mm is None:
            continue
        rows, cols = truth.indentation_mm.shape
        sheet = build_plane(translation, place, sensor.camera.resize(rows, cols), moved)
        found.append(HeightMap(name=f"true_{place}", title=f"Truth, {place}", place=place, heights_mm=truth.indentation_mm,
                           plane=sheet, contact=truth.contact))  # fmt: skip
    return tuple(found)


def format_csv(section: CrossSection) -> str:
    """The section as a table: a row for each place, a column for each profile, nothing where there is no value."""
    titles = ",".join(f"{profile.name}_mm" for profile in section.profiles)
    rows = [f"along_mm,{titles}".rstrip(",")]
    for k, along in enumerate(section.along_mm):
        values = (float(profile.heights_mm[k]) for profile in section.profiles)
        rows.append(",".join([f"{along:.4f}", *("" if math.isnan(v) else f"{v:.5f}" for v in values)]))
    return "\n".join([*rows, ""])
