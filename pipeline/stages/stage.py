"""A stage: one value of the pipeline, the methods that compute it, and everything other packages need to know of it.

Columns, 3D views, sheets, metrics, traces, options and cache keys are derived from these entries. A new method is one
module and one line in the table of its stage; a new stage is one folder and one line in the catalogue.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Indices
from pipeline.engine.graph import Method
from pipeline.geometry.meshes import Mesh
from pipeline.geometry.symmetry import Symmetry
from pipeline.previews.display_params import DisplayParams
from pipeline.previews.layers import Layer
from pipeline.previews.preview import Preview
from pipeline.sensors.spec import SensorSpec
from pipeline.values.frames import TactileFrame, Truth

SensorRole = Literal["source", "target"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PreviewContext:
    """Inputs of a stage's preview and 3D layers."""

    outputs: Mapping[str, Any]  # stage -> value, of the stages computed so far
    source: SensorSpec
    target: SensorSpec
    mesh: Mesh | None
    display: DisplayParams


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundTruth:
    """What is exactly known about a frame of source and target; None where it is unknown."""

    source_truth: Truth | None = None
    target_observation: TactileFrame | None = None  # what the target sensor recorded of the same touch
    target_truth: Truth | None = None
    mesh: Mesh | None = None  # of the object whose pose is known
    symmetry: Symmetry | None = None  # of that object; None = unknown, treated as none


@dataclass(frozen=True, slots=True, kw_only=True)
class StepCurve:
    """One value per kept step."""

    name: str
    unit: str
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class StepHistory:
    """Curves and descriptions of the steps that led to a value."""

    curves: tuple[StepCurve, ...]
    stop_reason: str  # why the iteration ended
    descriptions: tuple[str, ...]  # one sentence per step
    phase_starts: tuple[int, ...] = ()  # steps at which a new phase begins


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbePoint:
    """Where a traced pixel is in one stage."""

    stage: str  # or "source"
    index: int  # flat index into the elements of that stage, -1 = the trace ended before
    row: int = -1  # of an image, -1 for a stage without one
    col: int = -1
    point_mm: tuple[float, float, float] | None = None  # in the frame of the stage's sensor
    text: str  # value there, or why the trace ends


def _no_ground_truth(_facts: GroundTruth, _sensor: SensorSpec) -> Any | None:
    return None


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """Everything about one stage."""

    name: str
    title: str
    legend: str  # of the 3D view
    sensor_role: SensorRole  # sensor whose frame positions are in
    methods: tuple[Method, ...]  # the first is the default
    make_preview: Callable[[Any, PreviewContext], Preview]
    make_layers: Callable[[Any, PreviewContext, Preview], tuple[Layer, ...]]
    trace_point: Callable[[Any, ProbePoint], ProbePoint]  # (value, point in its input) -> point here
    compute_metrics: Callable[[Any, GroundTruth], Mapping[str, float]] = lambda _v, _f: {}  # name in METRICS -> value
    make_ground_truth: Callable[[GroundTruth, SensorSpec], Any | None] = _no_ground_truth  # value of this stage
    preview_stages: tuple[str, ...] = ()  # other stages that the preview shows
    exaggerates_indentation: bool = True  # whether the 3D view stretches indentation
    has_steps: bool = False  # whether values may keep `steps`
    split_steps: Callable[[Any], tuple[Any, ...]] = lambda _v: ()  # the kept steps as values of this stage
    make_step_layers: Callable[[Any, PreviewContext, Preview], tuple[Layer, ...]] = (
        lambda _v, _c, _p: ()
    )  # none = as the value
    summarise_steps: Callable[[Any], StepHistory | None] = lambda _v: None

    @property
    def has_ground_truth(self) -> bool:
        """Whether a recording can know the true value of this stage."""
        return self.make_ground_truth is not _no_ground_truth


def look_up_element(source_index: Indices, source_element: int) -> int:
    """The first element (flat) made from `source_element` of the previous stage; -1 if none was."""
    flat = source_index.reshape(-1)
    if 0 <= source_element < flat.size and flat[source_element] == source_element:  # most stages keep the grid
        return source_element
    matches = np.flatnonzero(flat == source_element)
    return int(matches[0]) if matches.size else -1


def to_xyz(point: NDArray[np.floating]) -> tuple[float, float, float]:
    """A point (3,) as three floats."""
    x, y, z = (float(v) for v in point)
    return x, y, z
