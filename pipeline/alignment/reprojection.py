"""Adaptation and projection in one go, for an alignment that is being dragged: depth in, the target's view out.

The answer is that of `project(adapt(...))` to the bit. A preview looks at every n-th source pixel and draws into a
smaller image of the same target, `scaled(target, 1 / n)`.
"""

from __future__ import annotations

from pipeline.base.errors import SettingProblem
from pipeline.base.progress import SILENT, Progress
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.adapt.stage import AdaptParams, adapt
from pipeline.stages.project.stage import Projection, project
from pipeline.values.results import DepthMap, TargetView


def reproject(
    depth: DepthMap,
    alignment: Alignment,
    target: SensorSpec,
    params: Projection,
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

    Raises SettingProblem when `factor` is not positive and finite.
    """
    if not 0.0 < factor < float("inf"):
        raise SettingProblem(f"a sensor is scaled by a positive factor, got {factor!r}")
    return spec.seen_through(spec.camera.scaled(factor))
