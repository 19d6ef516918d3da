"""Section: the heights of every stage along one line, in millimetres on the source's gel.

The line lies on the source's rest surface, taken as flat. It is transferred to the target as the
touch is, and a camera sees a straight line as a straight line.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pipeline.core.arrays import Doubles, Mask, Reals, freeze
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.core.values.frames import Truth
from pipeline.core.values.results import DepthMap
from pipeline.sensors.alignment import Offsets
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.stage import GroundTruth, SensorRole
from pipeline.translation.pixel_trace import SOURCE
from pipeline.translation.translate import Translation
from pipeline.views.preview import PixelPositions, Preview

NO_OFFSETS = Offsets()
_ROUNDING = 1e-9  # of the share of the neighbours that have a value
N_SAMPLES = 257  # along a line: finer than the pixels of all described sensors
_HEIGHTS = "+ toward camera"  # suffix of quantities that are heights over the rest surface


@frozen
class SectionLine:
    """A line from (x, y) to (x, y), mm from the source camera's axis in the gel's plane."""

    begin_mm: tuple[float, float]
    end_mm: tuple[float, float]

    @property
    def length_mm(self) -> float:
        """Length of the line."""
        return math.dist(self.begin_mm, self.end_mm)

    @property
    def plain(self) -> list[float]:
        """Return x, y of start and end for a session file."""
        return [*self.begin_mm, *self.end_mm]

    def points_mm(self, count: int = N_SAMPLES) -> Doubles:
        """Return points (count, 2) at equal distances, both ends included."""
        return np.linspace(self.begin_mm, self.end_mm, count)


@frozen
class SectionPlane:
    """The plane of the line as one camera sees it; pixel centres are integers."""

    camera: Camera
    plane_z_mm: float  # z of the plane in the source frame
    # (4, 4) camera frame from source frame; None = the source's own camera
    camera_from_source: Doubles | None = None

    def project_to_px(self, points_mm: ArrayLike) -> Doubles:
        """Return the pixels (n, 2) x, y of points (n, 2) of the plane; NaN behind the lens."""
        flat = np.asarray(points_mm, dtype=np.float64)
        points = np.column_stack([flat, np.full(len(flat), self.plane_z_mm)])
        if self.camera_from_source is not None:
            points = rigid.apply(self.camera_from_source, points)
        x_px, y_px, _ = self.camera.project(points)
        found = np.column_stack([x_px, y_px])
        found[points[:, 2] <= MIN_DEPTH_MM] = np.nan
        return found

    def backproject_to_mm(self, x_px: float, y_px: float) -> tuple[float, float]:
        """Return the point of the plane at an image position.

        NaN where the plane is seen edge on.
        """
        camera = self.camera
        ray = np.array(
            [(x_px - camera.cx_px) / camera.fx_px, (y_px - camera.cy_px) / camera.fy_px, 1.0]
        )
        eye = np.zeros(3)
        if self.camera_from_source is not None:
            back = rigid.invert(self.camera_from_source)
            eye = back[:3, 3]
            ray = back[:3, :3] @ ray
        if abs(ray[2]) < 1e-9:
            return math.nan, math.nan
        x, y, _ = eye + (self.plane_z_mm - eye[2]) / ray[2] * ray
        return float(x), float(y)


@frozen
class HeightMap:
    """A height for each pixel of an image."""

    name: str  # a stage, "source", "true_source" or "true_target"
    title: str
    place: SensorRole  # sensor whose rest surface the heights are over
    heights_mm: Reals  # (rows, cols) + toward the camera, NaN = no value
    plane: SectionPlane
    contact: Mask | None = None  # (rows, cols)


@frozen
class HeightProfile:
    """The heights of one height map along the line."""

    name: str
    title: str
    place: SensorRole
    heights_mm: Doubles  # (n,), NaN = no value, or outside the image
    contact_edges_mm: tuple[float, ...] = ()  # along the line, where its contact begins or ends


@frozen
class CrossSection:
    """All height profiles along one line."""

    line: SectionLine
    along_mm: Doubles  # (n,) from the start of the line
    profiles: tuple[HeightProfile, ...]


def sample_bilinear(values: Reals, px: Doubles) -> Doubles:
    """Return bilinear samples (n,) of values (rows, cols) at x, y (n, 2).

    NaN outside the image, and where one of the four neighbours has no value.
    """
    from scipy.ndimage import map_coordinates

    x, y = px.T
    rows, cols = values.shape
    inside = (x >= 0) & (x <= cols - 1) & (y >= 0) & (y <= rows - 1)  # False for NaN coordinates
    places = np.where(inside, (y, x), 0.0)
    known = np.isfinite(values)
    found, share = (
        np.asarray(map_coordinates(one, places, order=1, mode="nearest", output=np.float64))
        for one in (np.where(known, values, 0.0), known.astype(np.float64))
    )
    return np.where(inside & (share > 1.0 - _ROUNDING), found, np.nan)


def cut_section(
    line: SectionLine, fields: Sequence[HeightMap], count: int = N_SAMPLES
) -> CrossSection:
    """Return every height map along the line, at `count` points."""
    points = line.points_mm(count)
    along = np.linspace(0.0, line.length_mm, count)
    return CrossSection(
        line=line,
        along_mm=freeze(along),
        profiles=tuple(_profile(f, points, along) for f in fields),
    )


def _profile(field: HeightMap, points_mm: Doubles, along_mm: Doubles) -> HeightProfile:
    px = field.plane.project_to_px(points_mm)
    edges: tuple[float, ...] = ()
    if field.contact is not None:
        turns = np.flatnonzero(
            np.diff(np.nan_to_num(sample_bilinear(field.contact.astype(np.float32), px)) >= 0.5)
        )
        edges = tuple(float(mm) for mm in 0.5 * (along_mm[turns] + along_mm[turns + 1]))
    return HeightProfile(
        name=field.name,
        title=field.title,
        place=field.place,
        contact_edges_mm=edges,
        heights_mm=freeze(sample_bilinear(field.heights_mm, px)),
    )


def build_plane(
    translation: Translation, place: SensorRole, camera: Camera, moved: Offsets = NO_OFFSETS
) -> SectionPlane:
    """Return the plane of the line as the source's or target's camera sees it, the alignment
    offset by `moved`.
    """
    rest = translation.source.rest_depth_mm
    return SectionPlane(
        camera=camera,
        plane_z_mm=float(rest[rest.shape[0] // 2, rest.shape[1] // 2]),
        camera_from_source=None
        if place == "source"
        else moved.apply_to(translation.alignment).target_from_source,
    )


def find_image_camera(picture: Preview, sensor: SensorSpec) -> Camera:
    """Return the camera whose pixels are the preview's."""
    shape = picture.pixels.shape[0], picture.pixels.shape[1]
    laid = picture.positions_mm
    known = laid.camera if isinstance(laid, PixelPositions) else picture.camera
    return known if known is not None and known.shape == shape else sensor.camera.resize(*shape)


def build_height_map(
    name: str, title: str, place: SensorRole, value: object, picture: Preview, sheet: SectionPlane
) -> HeightMap | None:
    """Return the heights of a stage's membrane, else of its preview; None without any."""
    membrane = getattr(value, "membrane", None)
    scale = picture.scale
    if isinstance(membrane, DepthMap):
        heights = membrane.indentation_mm
        contact: Mask | None = membrane.contact
        sheet = replace(sheet, camera=membrane.camera)
    elif (
        picture.values is not None
        and scale is not None
        and scale.unit == "mm"
        and scale.quantity.endswith(_HEIGHTS)
    ):
        heights = picture.values
        contact = getattr(value, "contact", None)
        if contact is not None and contact.shape != heights.shape:
            contact = None
    else:
        return None
    return HeightMap(
        name=name, title=title, place=place, heights_mm=heights, plane=sheet, contact=contact
    )


def collect_height_maps(
    translation: Translation,
    facts: GroundTruth | None,
    shown: Iterable[tuple[str, Preview, object]],
    moved: Offsets = NO_OFFSETS,
) -> tuple[HeightMap, ...]:
    """Return true heights, then the heights of (stage or "source", preview, value)."""
    found = [] if facts is None else list(build_true_height_maps(facts, translation, moved))
    for name, picture, value in shown:
        stage = None if name == SOURCE else translation.catalogue.stage(name)
        place: SensorRole = "source" if stage is None else stage.sensor_role
        camera = find_image_camera(
            picture, translation.source if place == "source" else translation.target
        )
        title = "Source" if stage is None else stage.title
        field = build_height_map(
            name, title, place, value, picture, build_plane(translation, place, camera, moved)
        )
        found += [] if field is None else [field]
    return tuple(found)


def build_true_height_maps(
    facts: GroundTruth, translation: Translation, moved: Offsets = NO_OFFSETS
) -> tuple[HeightMap, ...]:
    """Return the true heights on either side, where known."""
    found: list[HeightMap] = []
    sides: tuple[tuple[SensorRole, Truth | None, SensorSpec], ...] = (
        ("source", facts.source_truth, translation.source),
        ("target", facts.target_truth, translation.target),
    )
    for place, truth, sensor in sides:
        if truth is None or truth.indentation_mm is None:
            continue
        rows, cols = truth.indentation_mm.shape
        sheet = build_plane(translation, place, sensor.camera.resize(rows, cols), moved)
        found.append(
            HeightMap(
                name=f"true_{place}",
                title=f"Truth, {place}",
                place=place,
                heights_mm=truth.indentation_mm,
                plane=sheet,
                contact=truth.contact,
            )
        )
    return tuple(found)


def format_csv(section: CrossSection) -> str:
    """Return the section as CSV: a row per point, a column per profile, empty where there is no
    value.
    """
    titles = ",".join(f"{profile.name}_mm" for profile in section.profiles)
    rows = [f"along_mm,{titles}".rstrip(",")]
    for k, along in enumerate(section.along_mm):
        values = (float(profile.heights_mm[k]) for profile in section.profiles)
        rows.append(
            ",".join([f"{along:.4f}", *("" if math.isnan(v) else f"{v:.5f}" for v in values)])
        )
    return "\n".join([*rows, ""])
