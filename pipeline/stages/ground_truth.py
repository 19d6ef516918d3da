"""The true value of each stage, from what a recording knows about a frame.

Used for truth views, and put in place of computed values to attribute errors
(`translation.error_attribution`).

Stages whose value is a `DepthMap`: source depth and touch depth share metrics and truth.
"""

from collections.abc import Mapping

import numpy as np

from pipeline.core.arrays import freeze
from pipeline.core.graph import Method
from pipeline.core.values.frames import Truth
from pipeline.core.values.results import (
    DepthMap,
    GeneratedTouch,
    ObjectPose,
    TargetDepth,
    make_depth_map,
    make_pixel_index,
)
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.metrics.stage_metrics import compute_surface_metrics
from pipeline.stages.stage import GroundTruth, SensorRole, Stage

_NOTE = "ground truth of the recording"


def build_depth_map(
    ground_truth: GroundTruth, sensor_role: SensorRole, sensor: SensorSpec
) -> DepthMap | None:
    """True membrane of the sensor in `sensor_role`.

    None unless indentation and contact are known at its image size.
    """
    truth = ground_truth.source_truth if sensor_role == "source" else ground_truth.target_truth
    shape = sensor.camera.shape
    if truth is None or truth.indentation_mm is None or truth.contact is None:
        return None
    if truth.indentation_mm.shape != shape or truth.contact.shape != shape:
        return None
    return make_depth_map(
        sensor.rest_depth_mm, truth.indentation_mm, truth.contact, sensor.camera, notes=(_NOTE,)
    )


def build_target_depth(ground_truth: GroundTruth, target: SensorSpec) -> TargetDepth | None:
    """True object surface seen by the target: its membrane where it is in contact."""
    depth = build_depth_map(ground_truth, "target", target)
    if depth is None:
        return None
    shape = depth.contact.shape
    return TargetDepth(
        depth_mm=freeze(np.where(depth.contact, depth.depth_mm, np.float32(np.nan))),
        contact=depth.contact,
        indentation_mm=freeze(
            np.where(depth.contact, np.maximum(depth.indentation_mm, 0.0), 0.0).astype(np.float32)
        ),
        camera=depth.camera,
        source_index=freeze(np.full(shape, -1, np.int32)),
        in_view=freeze(np.ones(shape, np.bool_)),
        notes=(_NOTE,),
    )


def build_touch(ground_truth: GroundTruth, target: SensorSpec) -> GeneratedTouch | None:
    """What the target recorded of the same touch, with its true membrane."""
    frame = ground_truth.target_observation
    if frame is None or frame.image.shape[:2] != target.camera.shape:
        return None
    depth = build_depth_map(ground_truth, "target", target)
    return GeneratedTouch(
        image=frame.image,
        camera=frame.camera or target.camera,
        source_index=make_pixel_index(target.camera.shape),
        in_view=freeze(np.ones(target.camera.shape, np.bool_)),
        membrane=depth,
        notes=(_NOTE,),
        reference=np.asarray(frame.reference, np.float32)
        if frame.is_depth and frame.reference is not None
        else None,
    )


def build_pose(ground_truth: GroundTruth, target: SensorSpec) -> ObjectPose | None:
    """True object pose; its points are those of the true contact, empty where the contact is
    unknown.
    """
    truth: Truth | None = ground_truth.target_truth
    if truth is None or truth.sensor_from_object is None:
        return None
    depth = build_depth_map(ground_truth, "target", target)
    pixels = (
        np.zeros(0, np.int32) if depth is None else np.flatnonzero(depth.contact).astype(np.int32)
    )
    points = (
        np.zeros((0, 3))
        if depth is None
        else depth.camera.back_project(depth.depth_mm).reshape(-1, 3)[pixels]
    )
    return ObjectPose(
        sensor_from_object=truth.sensor_from_object,
        rmse_mm=0.0,
        fitness=1.0,
        scene_mm=freeze(points.astype(np.float32)),
        source_index=freeze(pixels),
        notes=(_NOTE,),
    )


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
        return build_depth_map(facts, sensor_role, there)

    return Stage(
        name=name,
        title=title,
        sensor_role=sensor_role,
        methods=methods,
        value_type=DepthMap,
        compute_metrics=compute_metrics,
        make_ground_truth=make_ground_truth,
    )
