"""A slot: a value that people look at, the methods that can fill it, and all that others need to know about it.

Columns, 3D views, sheets, metrics, traces, options and cache keys are derived from these entries: a method is one
module and one line in its slot's table, a slot is one folder and one line in the catalogue.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

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
    """What a slot's picture and layers are made of."""

    outputs: Mapping[str, Any]  # slot -> value, of those worked out so far
    source: SensorSpec
    target: SensorSpec
    mesh: Mesh | None
    display: DisplayParams


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundTruth:
    """What is exactly known of a frame, on either side; None where it is not."""

    source_truth: Truth | None = None
    target_observation: TactileFrame | None = None  # what the target sensor recorded of the same touch
    target_truth: Truth | None = None
    mesh: Mesh | None = None  # of the object that the true pose is about
    symmetry: Symmetry | None = None  # of that object; None = not known, taken as none


@dataclass(frozen=True, slots=True, kw_only=True)
class StepCurve:
    """A figure of every kept step."""

    name: str
    unit: str
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class StepHistory:
    """What is told of the steps that led to a value."""

    curves: tuple[StepCurve, ...]
    stop_reason: str  # why it ended where it did
    descriptions: tuple[str, ...]  # each of them in words
    phase_starts: tuple[int, ...] = ()  # steps with which something else begins


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbePoint:
    """Where a traced pixel is in one slot."""

    stage: str  # or "source"
    index: int  # flat index into that slot's elements, -1 = it does not get there
    row: int = -1  # of an image, -1 where the slot is no image
    col: int = -1
    point_mm: tuple[float, float, float] | None = None  # in the frame of the slot's place
    text: str  # what is there, or why the trace ends


def _not_known(_facts: GroundTruth, _sensor: SensorSpec) -> Any | None:
    return None


def _no_states(_value: Any) -> tuple[Any, ...]:
    return ()


def _no_layers(_state: Any, _seen: PreviewContext, _picture: Preview) -> tuple[Layer, ...]:
    return ()


def _no_way(_value: Any) -> StepHistory | None:
    return None


def _no_figures(_value: Any, _facts: GroundTruth) -> Mapping[str, float]:
    return {}


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """Everything about one slot."""

    name: str
    title: str
    legend: str  # of its 3D view
    sensor_role: SensorRole  # whose frame its positions are in
    methods: tuple[Method, ...]  # the first is the one that is meant where nobody says
    make_preview: Callable[[Any, PreviewContext], Preview]
    make_layers: Callable[[Any, PreviewContext, Preview], tuple[Layer, ...]]
    trace_point: Callable[[Any, ProbePoint], ProbePoint]  # (value, mark in what it was made from) -> mark here
    compute_metrics: Callable[[Any, GroundTruth], Mapping[str, float]] = _no_figures  # name in METRICS -> value
    make_ground_truth: Callable[[GroundTruth, SensorSpec], Any | None] = (
        _not_known  # (facts, sensor at its place) -> its value
    )
    preview_stages: tuple[str, ...] = ()  # other slots that the picture shows
    exaggerates_indentation: bool = True  # whether its 3D view draws indentation longer than it is
    has_steps: bool = False  # whether its value may keep `steps`
    split_steps: Callable[[Any], tuple[Any, ...]] = (
        _no_states  # of those steps that are pictures of their own, as values,
    )
    make_step_layers: Callable[[Any, PreviewContext, Preview], tuple[Layer, ...]] = (
        _no_layers  # their 3D; none = the value's own
    )
    summarise_steps: Callable[[Any], StepHistory | None] = _no_way  # to the value, where steps were kept
