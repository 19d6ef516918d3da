"""The catalogue of stages, their methods, and the routes through them.

Columns, options, sheets, metrics and traces are derived from it. A route is data: it names a method
for each of its stages and leaves out the others.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any, TypeVar

from pipeline.core.entry_points import load_entry_points
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.graph import Method
from pipeline.core.params import Value, list_settings, replace_value, split_assignment
from pipeline.stages.cloud.stage import STAGE as CLOUD
from pipeline.stages.depth.stage import STAGE as DEPTH
from pipeline.stages.pose.stage import STAGE as POSE
from pipeline.stages.stage import SensorRole, Stage, make_truth_method
from pipeline.stages.target_depth.stage import STAGE as TARGET_DEPTH
from pipeline.stages.touch.stage import STAGE as TOUCH
from pipeline.stages.touch_depth.stage import STAGE as TOUCH_DEPTH
from pipeline.views.image_views import TARGET_DEPTH as TARGET_DEPTH_VIEW
from pipeline.views.image_views import TOUCH as TOUCH_VIEW
from pipeline.views.image_views import make_depth_view
from pipeline.views.point_views import CLOUD as CLOUD_VIEW
from pipeline.views.point_views import POSE as POSE_VIEW
from pipeline.views.view import View

log = logging.getLogger("tactoscope")
VIEWS: Mapping[str, View] = {
    "depth": make_depth_view("depth", "measured surface", "source"),
    "cloud": CLOUD_VIEW,
    "target_depth": TARGET_DEPTH_VIEW,
    "touch": TOUCH_VIEW,
    "touch_depth": make_depth_view("touch_depth", "depth of the generated touch", "target"),
    "pose": POSE_VIEW,
}  # stage -> how its value is shown


@frozen
class Route:
    """A method for each stage between the source's frame and the object's pose."""

    name: str
    title: str
    methods: Mapping[str, str]  # stage -> method, in running order
    needs_mesh: bool = False  # of the touched object

    @property
    def label(self) -> str:
        """What the window calls the route: the part of its title after the name."""
        return self.title.partition(": ")[2] or self.title


NamedEntry = TypeVar("NamedEntry", Stage, Route, Method)


@frozen
class Catalogue:
    """All stages in the order of their columns, and the routes."""

    stages: tuple[Stage, ...]
    routes: tuple[Route, ...]
    # stage -> how its value is shown
    views: Mapping[str, View] = field(default_factory=lambda: VIEWS)

    def stage(self, name: str) -> Stage:
        """The stage of that name; raises SettingProblem."""
        return _find_by_name(self.stages, name, f"stage {name!r}")

    def route(self, name: str, *, has_mesh: bool = False) -> Route:
        """The route of that name; "" is the default, through the object where its mesh is known.

        Raises SettingProblem.
        """
        if not name:
            fitting = (route for route in self.routes if route.needs_mesh == has_mesh)
            return next(fitting, self.routes[0])
        return _find_by_name(self.routes, name, f"route {name!r}")

    def method(self, stage: str, name: str) -> Method:
        """A method of a stage, or its truth.

        Raises SettingProblem that lists the stage's methods.
        """
        what = f"method {name!r} for the stage {stage!r}"
        return _find_by_name(self.list_choices(stage), name, what)

    def list_choices(self, stage: str) -> tuple[Method, ...]:
        """The methods of a stage, and the one that takes the truth of the recording where it can
        be known.
        """
        entry = self.stage(stage)
        return (
            (*entry.methods, make_truth_method(entry)) if entry.has_ground_truth else entry.methods
        )

    def methods(
        self,
        route: str,
        chosen: Mapping[str, str] | None = None,
        kinds: Mapping[SensorRole, str] | None = None,
    ) -> tuple[Method, ...]:
        """The methods of a route in running order, with those in `chosen` (stage -> method) in
        place of its own.

        One that does not fit the kind of its stage's sensor (`kinds`, where known) makes way for
        the stage's first that does. A choice for a stage that the route leaves out is ignored.
        Raises SettingProblem for an unknown name.
        """
        names = dict(chosen or {})
        for stage, name in names.items():
            self.method(stage, name)
        return tuple(
            self._find_fitting(stage, names.get(stage, name), kinds or {})
            for stage, name in self.route(route).methods.items()
        )

    def _find_fitting(self, stage: str, name: str, kinds: Mapping[SensorRole, str]) -> Method:
        entry = self.stage(stage)
        kind = kinds.get(entry.sensor_role, "")
        return next(m for m in (self.method(stage, name), *entry.methods) if m.fits(kind))

    def add_methods(self, methods: Iterable[Method]) -> Catalogue:
        """Return the catalogue with more methods, after the stages' own.

        Unusable ones are left out with a warning.
        """
        catalogue = self
        for method in methods:
            try:
                catalogue = catalogue.add_method(method)
            except SettingProblem as problem:
                log.warning("tactoscope.methods: %s; it is left out", problem)
        return catalogue

    def add_method(self, method: Method) -> Catalogue:
        """Return the catalogue with one more method, after its stage's own.

        Raises SettingProblem where there is no such stage, or another method of that name.
        """
        stage = self.stage(method.stage)
        method = replace(method, value_type=stage.value_type)
        if method in stage.methods:
            return self
        if any(method.name == known.name for known in stage.methods):
            raise SettingProblem(
                f"the stage {stage.name!r} already has a method {method.name!r}; choose another "
                "name"
            )
        extended = replace(stage, methods=(*stage.methods, method))
        return replace(
            self, stages=tuple(extended if s.name == stage.name else s for s in self.stages)
        )


def _find_by_name(entries: Sequence[NamedEntry], name: str, what: str) -> NamedEntry:
    for entry in entries:
        if entry.name == name:
            return entry
    raise SettingProblem(f"no {what}; there are {', '.join(e.name for e in entries)}")


def _check_params(method: Method) -> None:
    list_settings(method.params())


_T2D2 = Route(
    name="t2d2",
    title="T2D2: touch → depth → touch",
    methods={
        "depth": "network",
        "cloud": "back_projection",
        "target_depth": "surface",
        "touch": "t2d2",
        "touch_depth": "membrane",
        "pose": "signed_distances",
    },
)
BUILT_IN = Catalogue(
    stages=(DEPTH, CLOUD, TARGET_DEPTH, TOUCH, TOUCH_DEPTH, POSE),
    routes=(
        _T2D2,
        Route(
            name="t2t",
            title="T2T: touch → touch",
            methods={"touch": "t2t", "touch_depth": "membrane", "pose": "signed_distances"},
        ),
        Route(
            name="object",
            title="Object: touch → object → touch",
            methods={**_T2D2.methods, "touch": "object"},
            needs_mesh=True,
        ),
    ),
).add_methods(load_entry_points("tactoscope.methods", Method, _check_params))
"""The project's stages and routes, and the methods of other installed packages."""


def default_params(methods: tuple[Method, ...]) -> dict[str, object]:
    """Stage -> default parameters of its method."""
    return {method.stage: method.params() for method in methods}


def with_setting(params: Mapping[str, object], assignment: str) -> dict[str, object]:
    """`params` with one `stage.parameter=value` of the command line applied.

    Raises SettingProblem.
    """
    what = "a setting is written stage.parameter=value"
    left, value = split_assignment(assignment, what)
    stage, dot, name = left.partition(".")
    if not dot:
        raise SettingProblem(f"{what}, got {assignment!r}")
    if stage not in params:
        raise SettingProblem(f"no stage {stage!r} on this route; there are {', '.join(params)}")
    return {**params, stage: replace_parameter(params[stage], stage, name, value)}


def replace_parameter(params: Any, stage: str, name: str, value: Value) -> Any:
    """The parameters of a stage's method with another value of one of them.

    Raises SettingProblem, which names the methods that have such a parameter.
    """
    try:
        return replace_value(params, name, value)
    except SettingProblem as problem:
        others = [
            f"{stage}={method.name}"
            for method in BUILT_IN.stage(stage).methods
            if name in list_settings(method.params())
        ]
        if name in list_settings(params) or not others:
            raise
        raise SettingProblem(f"{problem}; choose a method with it: {', '.join(others)}") from None


def with_settings(methods: tuple[Method, ...], assignments: Sequence[str]) -> dict[str, object]:
    """`default_params` with every `stage.parameter=value` applied; raises SettingProblem."""
    return functools.reduce(with_setting, assignments, default_params(methods))


def with_weights(given: Mapping[str, Path], assignment: str) -> dict[str, Path]:
    """`given` (stage -> file) with one `stage=file`, or one `file` for the first stage whose method
    takes weights.

    Raises SettingProblem for a `word=file` whose word is no stage, unless a file of that whole name
    exists.
    """
    stage, equals, name = (part.strip() for part in assignment.partition("="))
    stages = [entry.name for entry in BUILT_IN.stages]
    if equals and stage in stages:
        return {**given, stage: Path(name)}
    if equals and not Path(assignment).exists() and "/" not in stage:
        raise SettingProblem(
            f"weights are given by stage=FILE, got {assignment!r}; stages are {', '.join(stages)}"
        )
    return {**given, "": Path(assignment)}


def with_method(chosen: Mapping[str, str], assignment: str) -> dict[str, str]:
    """`chosen` with one `stage=method` of the command line; raises SettingProblem."""
    what = "a method is chosen by stage=method"
    stage, name = split_assignment(assignment, what)
    if not name:
        raise SettingProblem(f"{what}, got {assignment!r}")
    return {**chosen, stage: name}
