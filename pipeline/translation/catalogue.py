"""Which slots there are, which methods fill them, and the routes through them.

Everything that shows or offers a slot, a method or a route reads it here: columns, options, sheets, metrics, traces. A
route is data: it names a method for each of its slots, and slots that it leaves out are not there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from pipeline.base.errors import SettingProblem
from pipeline.base.params import replace_value
from pipeline.engine.graph import Method
from pipeline.stages.cloud.stage import STAGE as CLOUD
from pipeline.stages.depth.stage import STAGE as DEPTH
from pipeline.stages.pose.stage import STAGE as POSE
from pipeline.stages.stage import Stage
from pipeline.stages.target_depth.stage import STAGE as VIEW
from pipeline.stages.touch.stage import STAGE as TOUCH
from pipeline.stages.touch_depth.stage import STAGE as FELT


@dataclass(frozen=True, slots=True, kw_only=True)
class Route:
    """One way from the source's reading to the object's pose."""

    name: str
    title: str
    methods: Mapping[str, str]  # slot -> method, in running order


NamedEntry = TypeVar("NamedEntry", Stage, Route, Method)


@dataclass(frozen=True, slots=True, kw_only=True)
class Catalogue:
    """All slots in the order of their columns, and the routes; another one may be given wherever this is read."""

    stages: tuple[Stage, ...]
    routes: tuple[Route, ...]

    def stage(self, name: str) -> Stage:
        """The slot of that name; raises SettingProblem."""
        return _named(self.stages, name, f"slot {name!r}")

    def route(self, name: str) -> Route:
        """The route of that name; raises SettingProblem."""
        return _named(self.routes, name, f"route {name!r}")

    def method(self, stage: str, name: str) -> Method:
        """A method by name; raises SettingProblem with those that the slot has."""
        return _named(self.stage(stage).methods, name, f"method {name!r} for the slot {stage!r}")

    def methods(self, route: str, chosen: Mapping[str, str] | None = None) -> tuple[Method, ...]:
        """The methods of a route in running order, those in `chosen` (slot -> method) in place of its own.

        A choice for a slot that the route does not have is kept for another route and counts for nothing here.
        Raises SettingProblem for a name that does not exist.
        """
        said = dict(chosen or {})
        for slot, name in said.items():
            self.method(slot, name)
        return tuple(self.method(slot, said.get(slot, name)) for slot, name in self.route(route).methods.items())


def _named(entries: Sequence[NamedEntry], name: str, what: str) -> NamedEntry:
    for entry in entries:
        if entry.name == name:
            return entry
    raise SettingProblem(f"no {what}; there are {', '.join(e.name for e in entries)}")


BUILT_IN = Catalogue(
    stages=(DEPTH, CLOUD, VIEW, TOUCH, FELT, POSE),
    routes=(
        Route(
            name="t2d2",
            title="T2D2: touch to depth to touch",
            methods={
                "depth": "network",
                "cloud": "back_projection",
                "target_depth": "surface",
                "touch": "physics",
                "touch_depth": "membrane",
                "pose": "signed_distances",
            },
        ),
        Route(
            name="t2t",
            title="T2T: touch to touch, without depth between",
            methods={"touch": "t2t", "touch_depth": "membrane", "pose": "signed_distances"},
        ),
    ),
)


def default_params(methods: tuple[Method, ...]) -> dict[str, object]:
    """Slot -> the parameters of its method as they come."""
    return {method.stage: method.params() for method in methods}


def with_setting(params: Mapping[str, object], assignment: str) -> dict[str, object]:
    """`params` after one `slot.parameter=value`, as given on the command line; raises SettingProblem."""
    left, equals, value = assignment.partition("=")
    slot, dot, name = left.strip().partition(".")
    if not equals or not dot:
        raise SettingProblem(f"a setting is written slot.parameter=value, got {assignment!r}")
    if slot not in params:
        raise SettingProblem(f"no slot {slot!r} on this route; there are {', '.join(params)}")
    return {**params, slot: replace_value(params[slot], name, value.strip())}


def with_settings(methods: tuple[Method, ...], assignments: Sequence[str]) -> dict[str, object]:
    """`default_params` after every `slot.parameter=value`; raises SettingProblem."""
    params = default_params(methods)
    for assignment in assignments:
        params = with_setting(params, assignment)
    return params


def with_weights(given: Mapping[str, Path], assignment: str, catalogue: Catalogue = BUILT_IN) -> dict[str, Path]:
    """`given` (slot -> file) after one `slot=file`, or one `file` for the first slot whose method takes weights."""
    slot, equals, name = assignment.partition("=")
    known = equals and any(entry.name == slot.strip() for entry in catalogue.stages)
    return {**given, slot.strip(): Path(name.strip())} if known else {**given, "": Path(assignment)}


def with_method(chosen: Mapping[str, str], assignment: str) -> dict[str, str]:
    """`chosen` after one `slot=method`, as given on the command line; raises SettingProblem."""
    slot, equals, name = (part.strip() for part in assignment.partition("="))
    if not equals or not slot or not name:
        raise SettingProblem(f"a method is chosen by slot=method, got {assignment!r}")
    return {**chosen, slot: name}
