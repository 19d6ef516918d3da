"""Adaptation and projection in one go, for an alignment that is being dragged: depth in, the target's view out.

The answer is that of `project(adapt(...))` to the bit. A preview looks at every n-th source pixel and draws into a
smaller image of the same target, `scaled(target, 1 / n)`.
"""

from __future__ import annotations

from dataclasses import replace

from pipeline.base.arrays import freeze
from pipeline.base.errors import SettingProblem
from pipeline.base.progress import SILENT, Progress
from pipeline.geometry.camera import Camera
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.adapt.stage import AdaptParams, adapt
from pipeline.stages.project.stage import ProjectParams, project
from pipeline.values.results import DepthMap, TargetView

_KEPT = 32
_smaller: dict[tuple[int, float], tuple[SensorSpec, SensorSpec]] = {}  # by identity; the first of each keeps its id


def reproject(
    depth: DepthMap,
    alignment: Alignment,
    target: SensorSpec,
    params: ProjectParams,
    *,
    stride: int = 1,
    progress: Progress = SILENT,
) -> TargetView:
    """What `target` sees of `depth`: the bytes of `project(adapt(depth, alignment, stride), target, params)`.

    Raises what those raise: ShapeError, CalibrationError, SettingProblem.
    """
    return project(adapt(depth, alignment, AdaptParams(stride=stride), progress), target, params, progress)


def scaled(spec: SensorSpec, factor: float) -> SensorSpec:
    """The same sensor with `factor` times as many pixels along each side; membrane, frame and limits stay.

    Kept for the last few sensors, so that a drag does not work out the rest depth again. Raises SettingProblem when
    `factor` is not positive and finite.
    """
    if not 0.0 < factor < float("inf"):
        raise SettingProblem(f"a sensor is scaled by a positive factor, got {factor!r}")
    key = (id(spec), factor)
    if key not in _smaller:
        while len(_smaller) >= _KEPT:
            _smaller.pop(next(iter(_smaller)))
        camera: Camera = spec.camera.scaled(factor)
        rest = spec.membrane.rest_depth_mm(camera)
        _smaller[key] = (spec, replace(spec, camera=camera, rest_depth_mm=freeze(rest)))
    return _smaller[key][1]
