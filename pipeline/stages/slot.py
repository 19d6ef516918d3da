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
from pipeline.pictures.display import DisplayParams
from pipeline.pictures.layers import Layer
from pipeline.pictures.picture import Picture
from pipeline.sensors.spec import SensorSpec
from pipeline.values.frames import TactileFrame, Truth

Place = Literal["source", "target"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """What a slot's picture and layers are made of."""

    outputs: Mapping[str, Any]  # slot -> value, of those worked out so far
    source: SensorSpec
    target: SensorSpec
    mesh: Mesh | None
    display: DisplayParams


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """What is exactly known of a frame, on either side; None where it is not."""

    source: Truth | None = None
    target_frame: TactileFrame | None = None  # what the target sensor recorded of the same touch
    target: Truth | None = None
    mesh: Mesh | None = None  # of the object that the true pose is about
    symmetry: Symmetry | None = None  # of that object; None = not known, taken as none


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
    """A figure of every kept step."""

    name: str
    unit: str
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """What is told of the steps that led to a value."""

    curves: tuple[Curve, ...]
    told: str  # why it ended where it did
    steps: tuple[str, ...]  # each of them in words
    turns: tuple[int, ...] = ()  # steps with which something else begins


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """Where a traced pixel is in one slot."""

    slot: str  # or "source"
    index: int  # flat index into that slot's elements, -1 = it does not get there
    row: int = -1  # of an image, -1 where the slot is no image
    col: int = -1
    point_mm: tuple[float, float, float] | None = None  # in the frame of the slot's place
    text: str  # what is there, or why the trace ends


def _not_known(_facts: Facts, _sensor: SensorSpec) -> Any | None:
    return None


def _no_states(_value: Any) -> tuple[Any, ...]:
    return ()


def _no_layers(_state: Any, _seen: Seen, _picture: Picture) -> tuple[Layer, ...]:
    return ()


def _no_way(_value: Any) -> Way | None:
    return None


def _no_figures(_value: Any, _facts: Facts) -> Mapping[str, float]:
    return {}


@dataclass(frozen=True, slots=True, kw_only=True)
class Slot:
    """Everything about one slot."""

    name: str
    title: str
    legend: str  # of its 3D view
    place: Place  # whose frame its positions are in
    methods: tuple[Method, ...]  # the first is the one that is meant where nobody says
    picture: Callable[[Any, Seen], Picture]
    layers: Callable[[Any, Seen, Picture], tuple[Layer, ...]]
    follow: Callable[[Any, Mark], Mark]  # (value, mark in what it was made from) -> mark here
    figures: Callable[[Any, Facts], Mapping[str, float]] = _no_figures  # name in METRICS -> value
    truth: Callable[[Facts, SensorSpec], Any | None] = _not_known  # (facts, sensor at its place) -> its value
    looks_at: tuple[str, ...] = ()  # other slots that the picture shows
    stretches: bool = True  # whether its 3D view draws indentation longer than it is
    scrubs: bool = False  # whether its value may keep `steps`
    states: Callable[[Any], tuple[Any, ...]] = _no_states  # of those steps that are pictures of their own, as values,
    state_layers: Callable[[Any, Seen, Picture], tuple[Layer, ...]] = _no_layers  # their 3D; none = the value's own
    way: Callable[[Any], Way | None] = _no_way  # to the value, where steps were kept
