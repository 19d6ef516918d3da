"""What a stage's value looks like: preview, 3D layers, legend, trace and steps, as one entry of
the table `views`.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Indices
from pipeline.core.frozen import frozen
from pipeline.core.geometry.meshes import Mesh
from pipeline.sensors.spec import SensorSpec
from pipeline.views.display_params import DisplayParams
from pipeline.views.layers import Layer
from pipeline.views.preview import Preview


@frozen
class PreviewContext:
    """Inputs of a stage's preview and 3D layers."""

    outputs: Mapping[str, Any]  # stage -> value, of the stages computed so far
    source: SensorSpec
    target: SensorSpec
    mesh: Mesh | None
    display: DisplayParams


@frozen
class StepCurve:
    """One value per kept step."""

    name: str
    unit: str
    values: tuple[float, ...]


@frozen
class StepHistory:
    """Curves and descriptions of the steps that led to a value."""

    curves: tuple[StepCurve, ...]
    stop_reason: str  # why the iteration ended
    descriptions: tuple[str, ...]  # one sentence per step
    phase_starts: tuple[int, ...] = ()  # steps at which a new phase begins


@frozen
class ProbePoint:
    """Where a traced pixel is in one stage."""

    stage: str  # or "source"
    index: int = -1  # flat index into the elements of that stage, -1 = the trace ended before
    row: int = -1  # of an image, -1 for a stage without one
    col: int = -1
    point_mm: tuple[float, float, float] | None = None  # in the frame of the stage's sensor
    text: str  # value there, or why the trace ends


@frozen
class View:
    """How the value of one stage is shown."""

    legend: str  # of the 3D view
    make_preview: Callable[[Any, PreviewContext], Preview]
    make_layers: Callable[[Any, PreviewContext, Preview], tuple[Layer, ...]]
    # (value, point in its input) -> point here
    trace_point: Callable[[Any, ProbePoint], ProbePoint]
    preview_stages: tuple[str, ...] = ()  # other stages that the preview shows
    exaggerates_indentation: bool = True  # whether the 3D view stretches indentation
    # the kept steps as values of this stage
    split_steps: Callable[[Any], tuple[Any, ...]] = lambda _v: ()
    make_step_layers: Callable[[Any, PreviewContext, Preview], tuple[Layer, ...]] = (
        lambda _v, _c, _p: ()
    )  # none = as the value
    summarise_steps: Callable[[Any], StepHistory | None] = lambda _v: None


def look_up_element(source_index: Indices, source_element: int) -> int:
    """The first element (flat) made from `source_element` of the previous stage; -1 if none was."""
    flat = source_index.reshape(-1)
    # most stages keep the grid
    if 0 <= source_element < flat.size and flat[source_element] == source_element:
        return source_element
    matches = np.flatnonzero(flat == source_element)
    return int(matches[0]) if matches.size else -1


def to_xyz(point: NDArray[np.floating]) -> tuple[float, float, float]:
    """A point (3,) as three floats."""
    x, y, z = (float(v) for v in point)
    return x, y, z
