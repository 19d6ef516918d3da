"""The paper's stages, in its order, and the routes that go through them.

Adding a stage is one module and one line here: columns of the app, command-line options, cache keys and timings follow.
"""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.base.errors import SettingProblem
from pipeline.base.params import changed
from pipeline.engine.graph import Stage
from pipeline.stages.adapt import stage as adapt
from pipeline.stages.depth import stage as depth
from pipeline.stages.generate import stage as generate
from pipeline.stages.pose import stage as pose
from pipeline.stages.project import stage as project

STAGES: tuple[Stage, ...] = (
    Stage(
        name="depth",
        title="Depth",
        run=depth.depth,
        shortcut=depth.untouched,
        params=depth.DepthParams,
        reads=("frame", "source", "calibration"),
        version=3,
    ),
    Stage(
        name="adapt",
        title="Adapted cloud",
        run=adapt.adapt,
        shortcut=adapt.without_contact,
        params=adapt.AdaptParams,
        reads=("depth", "alignment"),
        version=2,
    ),
    Stage(
        name="project",
        title="Target depth and mask",
        run=project.project,
        shortcut=project.without_contact,
        params=project.ProjectParams,
        reads=("adapt", "target"),
        version=3,
    ),
    Stage(
        name="generate",
        title="Generated touch",
        run=generate.generate,
        shortcut=generate.without_contact,
        params=generate.GenerateParams,
        reads=("project", "target"),
    ),
    Stage(
        name="pose",
        title="Object pose",
        run=pose.posed,
        shortcut=pose.nothing_to_pose,
        params=pose.PoseParams,
        reads=("generate", "mesh", "previous"),
        version=2,
    ),
)

ROUTES: Mapping[str, tuple[str, ...]] = {"t2d2": ("depth", "adapt", "project", "generate", "pose")}


def route(name: str) -> tuple[str, ...]:
    """The stages of a route, in order; raises SettingProblem for one that does not exist."""
    if name not in ROUTES:
        raise SettingProblem(f"no route {name!r}; there are {', '.join(ROUTES)}")
    return ROUTES[name]


def default_params() -> dict[str, object]:
    """Stage name -> its parameters as they come."""
    return {stage.name: stage.params() for stage in STAGES}


def with_setting(params: Mapping[str, object], assignment: str) -> dict[str, object]:
    """`params` after one `stage.parameter=value`, as given on the command line; raises SettingProblem."""
    left, equals, value = assignment.partition("=")
    stage, dot, name = left.strip().partition(".")
    if not equals or not dot:
        raise SettingProblem(f"a setting is written stage.parameter=value, got {assignment!r}")
    if stage not in params:
        raise SettingProblem(f"no stage {stage!r}; there are {', '.join(params)}")
    return {**params, stage: changed(params[stage], name, value.strip())}
