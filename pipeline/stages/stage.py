"""A stage: one value of the pipeline, the methods that compute it, its metrics and its truth.

Columns, metrics, options and cache keys are derived from these entries; how a value is shown is in
`translation.catalogue`. A new method is one module and one line in the table of its stage; a new
stage is one folder, one line in the catalogue and one in the table of views.

The method that every stage with known truth has besides its own: what the recording knows in
place of a computation.

It pins a cause: with the truth in one stage, only the errors of those after it remain. Every result
made with it says so by a warning.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Literal

from pipeline.core.errors import SettingProblem, StageWarning
from pipeline.core.frozen import frozen
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.geometry.symmetry import Symmetry
from pipeline.core.graph import Method
from pipeline.core.params import NoParams
from pipeline.core.progress import Progress
from pipeline.core.values.frames import TactileFrame, Truth
from pipeline.sensors.spec import SensorSpec

SensorRole = Literal["source", "target"]


@frozen
class GroundTruth:
    """What is exactly known about a frame of source and target; None where it is unknown."""

    source_truth: Truth | None = None
    # what the target sensor recorded of the same touch
    target_observation: TactileFrame | None = None
    target_truth: Truth | None = None
    mesh: Mesh | None = None  # of the object whose pose is known
    symmetry: Symmetry | None = None  # of that object; None = unknown, treated as none


def _no_ground_truth(_facts: GroundTruth, _sensor: SensorSpec) -> Any | None:
    return None


@frozen
class Stage:
    """Everything about one stage."""

    name: str
    title: str
    sensor_role: SensorRole  # sensor whose frame positions are in
    methods: tuple[Method, ...]  # the first is the default
    value_type: type[Any] = object  # of what they return
    # name in METRICS -> value
    compute_metrics: Callable[[Any, GroundTruth], Mapping[str, float]] = lambda _v, _f: {}
    # value of this stage
    make_ground_truth: Callable[[GroundTruth, SensorSpec], Any | None] = _no_ground_truth
    has_steps: bool = False  # whether values may keep `steps`

    @property
    def has_ground_truth(self) -> bool:
        """Whether a recording can know the true value of this stage."""
        return self.make_ground_truth is not _no_ground_truth


TRUTH = "truth"  # name of the method


def make_truth_method(stage: Stage) -> Method:
    """Return the method whose value is the recording's truth of a stage."""
    return Method(
        stage=stage.name,
        name=TRUTH,
        title="Truth",
        run=partial(_return_truth, stage.title.lower()),
        params=NoParams,
        reads=(get_input_name(stage.name),),
        help="what the recording knows, in place of a computation",
    )


def get_input_name(stage: str) -> str:
    """Return the name of the input that holds a stage's truth."""
    return f"true_{stage}"


def _return_truth(title: str, value: Any | None, _params: NoParams, _progress: Progress) -> Any:
    if value is None:
        raise SettingProblem(
            f"the recording does not know the true {title} of this frame; choose another method "
            "for it"
        )
    warning = StageWarning(
        f"with true {title}: the recording's truth is in place of a computation; unpin it"
    )
    return replace(value, notes=(warning, *value.notes))
