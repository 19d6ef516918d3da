"""Stages whose value is a `DepthMap`: source depth and touch depth share preview, layers, trace and metrics."""

from collections.abc import Mapping

import numpy as np

from pipeline.engine.graph import Method
from pipeline.metrics.stage_metrics import compute_surface_metrics
from pipeline.previews.layers import Layer, make_membrane_layer, make_surface_layer
from pipeline.previews.preview import Preview, make_indentation_preview
from pipeline.sensors.spec import SensorSpec
from pipeline.stages import ground_truth
from pipeline.stages.stage import GroundTruth, PreviewContext, ProbePoint, SensorRole, Stage, look_up_element
from pipeline.values.results import DepthMap


def make_depth_stage(
    *, name: str, title: str, legend: str, sensor_role: SensorRole, methods: tuple[Method, ...]
) -> Stage:
    """A stage whose value is the indentation of the membrane of the sensor in `sensor_role`."""

    def select_sensor(context: PreviewContext) -> SensorSpec:
        return context.source if sensor_role == "source" else context.target

    def make_preview(depth: DepthMap, context: PreviewContext) -> Preview:
        return make_indentation_preview(
            depth.indentation_mm, depth.depth_mm, depth.contact, depth.camera, select_sensor(context), context.display
        )

    def make_layers(depth: DepthMap, context: PreviewContext, preview: Preview) -> tuple[Layer, ...]:
        stretch = context.display.get_depth_stretch(select_sensor(context))
        surface = make_surface_layer(name, depth.depth_mm, depth.indentation_mm, depth.camera, preview, stretch)
        return (surface,) if sensor_role == "source" else (surface, make_membrane_layer(context.target))

    def trace_point(depth: DepthMap, before: ProbePoint) -> ProbePoint:
        index = look_up_element(depth.source_index, before.index)
        return (
            _make_probe_point(name, depth, index)
            if index >= 0
            else ProbePoint(stage=name, index=-1, text="outside the depth map")
        )

    def compute_metrics(depth: DepthMap, facts: GroundTruth) -> Mapping[str, float]:
        truth = facts.source_truth if sensor_role == "source" else facts.target_truth
        return {} if truth is None else compute_surface_metrics(depth.indentation_mm, depth.contact, truth)

    def make_ground_truth(facts: GroundTruth, there: SensorSpec) -> DepthMap | None:
        return ground_truth.build_depth_map(facts, sensor_role, there)

    return Stage(
        name=name, title=title, legend=legend, sensor_role=sensor_role, methods=methods,
        make_preview=make_preview, make_layers=make_layers, trace_point=trace_point, compute_metrics=compute_metrics,
        make_ground_truth=make_ground_truth,
    )  # fmt: skip


def _make_probe_point(stage: str, depth: DepthMap, index: int) -> ProbePoint:
    """Position and value of one pixel on the membrane."""
    row, col = divmod(index, depth.camera.cols)
    value, z = float(depth.indentation_mm[row, col]), float(depth.depth_mm[row, col])
    ray_x, ray_y = depth.camera.rays()
    if not np.isfinite(value):
        text = "no depth measured here"
    elif not depth.contact[row, col]:
        text = f"{value:.3f} mm, not in contact"
    else:
        text = f"{value:.3f} mm"
    point = (float(ray_x[col]) * z, float(ray_y[row]) * z, z) if np.isfinite(z) else None
    return ProbePoint(stage=stage, index=index, row=row, col=col, point_mm=point, text=text)
