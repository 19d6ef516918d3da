"""Stages whose value is a `DepthMap`: source depth and touch depth share metrics and truth."""

from collections.abc import Mapping

from pipeline.core.graph import Method
from pipeline.core.values.results import DepthMap
from pipeline.sensors.spec import SensorSpec
from pipeline.stages import ground_truth
from pipeline.stages.metrics.stage_metrics import compute_surface_metrics
from pipeline.stages.stage import GroundTruth, SensorRole, Stage


def make_depth_stage(
    *, name: str, title: str, sensor_role: SensorRole, methods: tuple[Method, ...]
) -> Stage:
    """A stage whose value is the indentation of the membrane of the sensor in `sensor_role`."""

    def compute_metrics(depth: DepthMap, facts: GroundTruth) -> Mapping[str, float]:
        truth = facts.source_truth if sensor_role == "source" else facts.target_truth
        return (
            {}
            if truth is None
            else compute_surface_metrics(depth.indentation_mm, depth.contact, truth)
        )

    def make_ground_truth(facts: GroundTruth, there: SensorSpec) -> DepthMap | None:
        return ground_truth.build_depth_map(facts, sensor_role, there)

    return Stage(
        name=name,
        title=title,
        sensor_role=sensor_role,
        methods=methods,
        value_type=DepthMap,
        compute_metrics=compute_metrics,
        make_ground_truth=make_ground_truth,
    )
