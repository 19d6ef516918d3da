"""View bounds and probe points of the 3D views."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from pipeline.geometry import rigid
from pipeline.previews.display_params import DisplayParams
from pipeline.previews.layers import ViewBounds, stretch_depth
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.pixel_lookup import to_xyz
from pipeline.stages.stage import ProbePoint
from pipeline.translation.pixel_trace import SOURCE
from pipeline.translation.translate import Translation

_MARGIN = 1.4  # radius of the target's view, in radii of the source's, if the source is a gel


def compute_view_bounds(translation: Translation) -> dict[str, ViewBounds]:
    """Return column -> bounds of its 3D view: the source, or the part of the target that the source can touch."""
    source, target = translation.source, translation.target
    z, radius = float(np.median(source.rest_depth_mm)), _radius_mm(source)
    at_source = ViewBounds(centre_mm=(0.0, 0.0, z), radius_mm=radius, frame=source.name)
    centre = to_xyz(rigid.apply(translation.alignment.target_from_source, (0.0, 0.0, z)))
    reach = min(_radius_mm(target), _MARGIN * radius) if source.gel is not None else _radius_mm(target)
    at_target = ViewBounds(centre_mm=centre, radius_mm=reach, frame=f"target {target.name}")
    places = {
        stage.name: at_source if stage.sensor_role == "source" else at_target for stage in translation.catalogue.stages
    }
    return {SOURCE: at_source, **places}


def compute_trace_points(
    points: Iterable[ProbePoint], translation: Translation, display: DisplayParams
) -> dict[str, tuple[float, float, float]]:
    """Return column -> x, y, z in mm of the probed pixel on the drawn (stretched) surface; missing if not there."""
    positions: dict[str, tuple[float, float, float]] = {}
    for point in points:
        if point.point_mm is None or point.stage == SOURCE:
            continue
        sensor, stretch = translation.get_sensor(point.stage), get_depth_stretch(point.stage, translation, display)
        positions[point.stage] = _stretch_point(point.point_mm, sensor, stretch)
        if sensor is translation.source:  # gel images lie on the rest surface, bubble images on the measured one
            positions[SOURCE] = _stretch_point(point.point_mm, sensor, 1.0 if sensor.sensor_kind.is_depth else 0.0)
    return positions


def get_depth_stretch(column: str, translation: Translation, display: DisplayParams) -> float:
    """Return by how much the 3D view of a column exaggerates indentations."""
    is_stretched = column != SOURCE and translation.catalogue.stage(column).exaggerates_indentation
    return display.get_depth_stretch(translation.get_sensor(column)) if is_stretched else 1.0


def _stretch_point(
    point_mm: tuple[float, float, float], sensor: SensorSpec, stretch: float
) -> tuple[float, float, float]:
    return to_xyz(stretch_depth(np.array([point_mm], dtype=np.float32), sensor, stretch)[0])


def _radius_mm(sensor: SensorSpec) -> float:
    z, camera = float(np.median(sensor.rest_depth_mm)), sensor.camera
    return 0.5 * math.hypot(camera.cols * z / camera.fx_px, camera.rows * z / camera.fy_px)
