"""Where things are in the 3D views: what each looks at, and the dots of a traced pixel."""

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

_ROOM = 1.4  # around what a gel can have touched, in radii of its own view


def compute_view_bounds(translation: Translation) -> dict[str, ViewBounds]:
    """Where each column's view looks from: at the source, or at that part of the target which can be touched."""
    source, target = translation.source, translation.target
    z, radius = float(np.median(source.rest_depth_mm)), _radius_mm(source)
    at_source = ViewBounds(centre_mm=(0.0, 0.0, z), radius_mm=radius, frame=source.name)
    centre = to_xyz(rigid.apply(translation.alignment.target_from_source, (0.0, 0.0, z)))
    reach = min(_radius_mm(target), _ROOM * radius) if source.gel is not None else _radius_mm(target)
    at_target = ViewBounds(centre_mm=centre, radius_mm=reach, frame=f"target {target.name}")
    places = {
        slot.name: at_source if slot.sensor_role == "source" else at_target for slot in translation.catalogue.stages
    }
    return {SOURCE: at_source, **places}


def compute_trace_points(
    marks: Iterable[ProbePoint], translation: Translation, display: DisplayParams
) -> dict[str, tuple[float, float, float]]:
    """Where the traced pixel is in each 3D view, on the surfaces as drawn (stretched); columns it misses are absent."""
    found: dict[str, tuple[float, float, float]] = {}
    for mark in marks:
        if mark.point_mm is None or mark.stage == SOURCE:
            continue
        slot = translation.catalogue.stage(mark.stage)
        sensor = translation.source if slot.sensor_role == "source" else translation.target
        times = display.get_depth_stretch(sensor) if slot.exaggerates_indentation else 1.0
        found[mark.stage] = _stretched(mark.point_mm, sensor, times)
        if (
            slot.sensor_role == "source"
        ):  # a gel's picture is drawn on its rest surface, a bubble's where it was measured
            found[SOURCE] = _stretched(mark.point_mm, sensor, 1.0 if sensor.sensor_kind.is_depth else 0.0)
    return found


def _stretched(point_mm: tuple[float, float, float], sensor: SensorSpec, times: float) -> tuple[float, float, float]:
    return to_xyz(stretch_depth(np.array([point_mm], dtype=np.float32), sensor, times)[0])


def _radius_mm(sensor: SensorSpec) -> float:
    z, camera = float(np.median(sensor.rest_depth_mm)), sensor.camera
    return 0.5 * math.hypot(camera.cols * z / camera.fx_px, camera.rows * z / camera.fy_px)
