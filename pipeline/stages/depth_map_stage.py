"""Slots whose value is a `DepthMap`: the source's membrane and the target's are looked at alike."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.engine.graph import Method
from pipeline.metrics.stage_metrics import compute_surface_metrics
from pipeline.previews.layers import Layer, make_membrane_layer, make_surface_layer
from pipeline.previews.preview import Preview, make_indentation_preview
from pipeline.sensors.spec import SensorSpec
from pipeline.stages import ground_truth
from pipeline.stages.pixel_lookup import look_up_element
from pipeline.stages.stage import GroundTruth, PreviewContext, ProbePoint, SensorRole, Stage
from pipeline.values.results import DepthMap


def make_depth_stage(
    *, name: str, title: str, legend: str, sensor_role: SensorRole, methods: tuple[Method, ...]
) -> Stage:
    """The entry of a slot that holds how far the membrane of the sensor at `place` is pushed in."""

    def select_sensor(seen: PreviewContext) -> SensorSpec:
        return seen.source if sensor_role == "source" else seen.target

    def make_preview(depth: DepthMap, seen: PreviewContext) -> Preview:
        return make_indentation_preview(
            depth.indentation_mm, depth.depth_mm, depth.contact, depth.camera, select_sensor(seen), seen.display
        )

    def make_layers(depth: DepthMap, seen: PreviewContext, picture: Preview) -> tuple[Layer, ...]:
        times = seen.display.get_depth_stretch(select_sensor(seen))
        surface = make_surface_layer(name, depth.depth_mm, depth.indentation_mm, depth.camera, picture.pixels, times)
        return (surface,) if sensor_role == "source" else (surface, make_membrane_layer(seen.target))

    def trace_point(depth: DepthMap, before: ProbePoint) -> ProbePoint:
        index = look_up_element(depth.source_index, before.index)
        return (
            _mark(name, depth, index) if index >= 0 else ProbePoint(stage=name, index=-1, text="outside the depth map")
        )

    def compute_metrics(depth: DepthMap, facts: GroundTruth) -> Mapping[str, float]:
        truth = facts.source_truth if sensor_role == "source" else facts.target_truth
        return {} if truth is None else compute_surface_metrics(depth.indentation_mm, depth.contact, truth)

    def make_ground_truth(facts: GroundTruth, there: SensorSpec) -> DepthMap | None:
        return ground_truth.build_depth_map(facts, sensor_role, there)

    return Stage(
        name=name, title=title, legend=legend, sensor_role=sensor_role, methods=methods,
        make_preview=make_preview, make_layers=make_layers, trace_point=trace_point, compute_metrics=compute_metrics, make_ground_truth=make_ground_truth,
    )  # fmt: skip


def _mark(stage: str, depth: DepthMap, index: int) -> ProbePoint:
    """Where a pixel lies on the membrane."""
    row, col = divmod(index, depth.camera.cols)
    value, z = float(depth.indentation_mm[row, col]), float(depth.depth_mm[row, col])
    ray_x, ray_y = depth.camera.rays()
    if not np.isfinite(value):
        text = "no depth reading here"
    elif not depth.contact[row, col]:
        text = f"{value:.3f} mm, not in contact"
    else:
        text = f"{value:.3f} mm"
    point = (float(ray_x[col]) * z, float(ray_y[row]) * z, z) if np.isfinite(z) else None
    return ProbePoint(stage=stage, index=index, row=row, col=col, point_mm=point, text=text)
