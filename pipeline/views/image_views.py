"""How values are shown that are images of a sensor: source and touch depth, target depth,
generated touch.
"""

from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np

from pipeline.core.arrays import Floats, freeze
from pipeline.core.values.results import SAME_SURFACE_MM, DepthMap, GeneratedTouch, TargetDepth
from pipeline.sensors.spec import SensorSpec
from pipeline.views.layers import (
    Layer,
    make_frame_layer,
    make_grid_layer,
    make_membrane_layer,
    make_surface_layer,
)
from pipeline.views.preview import (
    INDENTATION_LABEL,
    PixelPositions,
    Preview,
    compute_rest_depth_mm,
    make_frame_preview,
    make_indentation_preview,
)
from pipeline.views.view import (
    PreviewContext,
    ProbePoint,
    StepCurve,
    StepHistory,
    View,
    look_up_element,
)


def make_depth_view(name: str, legend: str, sensor_role: Literal["source", "target"]) -> View:
    """The view of the stage `name`, which holds the indentation of the membrane of the sensor in
    `sensor_role`.
    """

    def select_sensor(context: PreviewContext) -> SensorSpec:
        return context.source if sensor_role == "source" else context.target

    def make_preview(depth: DepthMap, context: PreviewContext) -> Preview:
        return make_indentation_preview(
            depth.indentation_mm, depth, select_sensor(context), context.display
        )

    def make_layers(
        depth: DepthMap, context: PreviewContext, preview: Preview
    ) -> tuple[Layer, ...]:
        stretch = context.display.get_depth_stretch(select_sensor(context))
        surface = make_surface_layer(
            name, depth.depth_mm, depth.indentation_mm, depth.camera, preview, stretch
        )
        rest = () if sensor_role == "source" else (make_membrane_layer(context.target),)
        return (surface, *rest)

    def trace_point(depth: DepthMap, before: ProbePoint) -> ProbePoint:
        index = look_up_element(depth.source_index, before.index)
        return (
            _make_probe_point(name, depth, index)
            if index >= 0
            else ProbePoint(stage=name, text="outside the depth map")
        )

    return View(
        legend=legend, make_preview=make_preview, make_layers=make_layers, trace_point=trace_point
    )


def _make_probe_point(stage: str, depth: DepthMap, index: int) -> ProbePoint:
    """Position and value of one pixel on the membrane."""
    row, col = divmod(index, depth.camera.cols)
    value = float(depth.indentation_mm[row, col])
    text = f"{value:.3f} mm{'' if depth.contact[row, col] else ', not in contact'}"
    if not np.isfinite(value):
        text = "no depth measured here"
    point = PixelPositions(depth.camera, depth.depth_mm).compute_point_mm(row, col)
    return ProbePoint(
        stage=stage,
        index=index,
        row=row,
        col=col,
        point_mm=point if np.isfinite(point).all() else None,
        text=text,
    )


def _draw_target_depth(depth: TargetDepth, context: PreviewContext) -> Preview:
    """Indentation of the target's rest surface wherever there is depth, with the contact
    outline.
    """
    shown = freeze(
        np.asarray(
            compute_rest_depth_mm(context.target, depth.camera) - depth.depth_mm, dtype=np.float32
        )
    )
    caption = f"{INDENTATION_LABEL}; mask outlined"
    return make_indentation_preview(shown, depth, context.target, context.display, caption)


def _layer_target_depth(
    depth: TargetDepth, context: PreviewContext, preview: Preview
) -> tuple[Layer, ...]:
    """The surface seen by the target, over its faint rest surface."""
    rest = compute_rest_depth_mm(context.target, depth.camera)
    shown = rest - context.display.get_depth_stretch(context.target) * (rest - depth.depth_mm)
    return (
        make_grid_layer("target_depth", depth.camera.back_project(shown), preview),
        make_membrane_layer(context.target),
    )


def _trace_target_depth(depth: TargetDepth, before: ProbePoint) -> ProbePoint:
    """The target pixel of a cloud point; several points share one where the target is coarser."""
    point = before.point_mm
    if point is None:
        return ProbePoint(stage="target_depth", text="not in the cloud")
    x_px, y_px, visible = (a[0] for a in depth.camera.project(np.array([point])))
    if not visible:
        out_x = max(-x_px, x_px - depth.camera.cols + 1, 0.0)
        out_y = max(-y_px, y_px - depth.camera.rows + 1, 0.0)
        text = f"outside the image by {max(out_x, out_y):.0f} px"
        return ProbePoint(stage="target_depth", point_mm=point, text=text)
    row = int(np.floor(y_px + 0.5))
    col = int(np.floor(x_px + 0.5))
    seen_mm = float(depth.depth_mm[row, col])
    index = -1
    pixel_text = f"({col}, {row})"
    if not np.isfinite(seen_mm):
        text = f"{pixel_text}, omitted at a depth jump"
    elif point[2] > seen_mm + SAME_SURFACE_MM:
        text = f"{pixel_text}, hidden by a surface {point[2] - seen_mm:.2f} mm nearer"
    else:
        pushed_mm = float(depth.indentation_mm[row, col])
        index = row * depth.camera.cols + col
        text = f"{pixel_text}, " + (
            f"{pushed_mm:.3f} mm in" if depth.contact[row, col] else "does not reach the membrane"
        )
    return ProbePoint(
        stage="target_depth", index=index, row=row, col=col, point_mm=point, text=text
    )


TARGET_DEPTH = View(
    legend="surface seen by the target",
    make_preview=_draw_target_depth,
    make_layers=_layer_target_depth,
    trace_point=_trace_target_depth,
)


def _draw_touch(touch: GeneratedTouch, context: PreviewContext) -> Preview:
    membrane = touch.membrane
    return make_frame_preview(
        touch.image,
        touch.camera,
        context.target,
        context.display,
        depth_mm=None if membrane is None else membrane.depth_mm,
        contact=None if membrane is None else membrane.contact,
        reference=touch.reference,
        is_recorded=False,
    )


def _layer_touch(
    touch: GeneratedTouch, context: PreviewContext, preview: Preview
) -> tuple[Layer, ...]:
    """The target's membrane, textured with the generated image."""
    at = touch.membrane
    if at is None:
        return (make_frame_layer("touch", touch.image, touch.camera, preview, context.target),)
    times = context.display.get_depth_stretch(context.target)
    return (
        make_surface_layer("touch", at.depth_mm, at.indentation_mm, touch.camera, preview, times),
    )


def _trace_touch(touch: GeneratedTouch, before: ProbePoint) -> ProbePoint:
    index = look_up_element(touch.source_index, before.index)
    if index < 0:
        has_no_contact = touch.membrane is not None and not touch.membrane.contact.any()
        text = (
            "generated without contact"
            if has_no_contact
            else "source pixel unknown for this method"
        )
        return ProbePoint(stage="touch", text=text)
    row, col = divmod(index, touch.camera.cols)
    if touch.image.ndim == 2:
        text = f"{float(touch.image[row, col]):.2f} mm from the camera"
        if touch.membrane is not None:
            moved_mm = float(touch.membrane.indentation_mm[row, col])
            text = f"{abs(moved_mm):.2f} mm {'out' if moved_mm < 0 else 'in'}, {text}"
    else:
        text = "generated rgb {} {} {}".format(*touch.image[row, col].tolist())
    return ProbePoint(
        stage="touch", index=index, row=row, col=col, point_mm=before.point_mm, text=text
    )


def _split_steps(touch: GeneratedTouch) -> tuple[GeneratedTouch, ...]:
    return tuple(
        replace(touch, image=step.image, membrane=step.membrane, steps=()) for step in touch.steps
    )


def _summarise_steps(touch: GeneratedTouch) -> StepHistory | None:
    """Change per step and distance from the last step, and the step of convergence."""
    if not touch.steps:
        return None
    if np.isnan(touch.steps[0].sigma):
        return _summarise_poses(touch)
    heights = [np.nan_to_num(step.membrane.indentation_mm) for step in touch.steps]
    changes = [heights[0] * 0, *(b - a for a, b in pairwise(heights))]
    last_mm = tuple(_rms_mm(h - heights[-1]) for h in heights)
    span_mm = max(float(np.ptp(heights[-1])), 1e-9)
    far_mm = [np.percentile(np.abs(h - heights[-1]), 99.0) for h in heights]
    settled = next(k for k, mm in enumerate(far_mm) if mm <= span_mm / 255)
    return StepHistory(
        curves=(
            StepCurve(name="changed", unit="mm", values=tuple(_rms_mm(o) for o in changes)),
            StepCurve(name="from the last", unit="mm", values=last_mm),
        ),
        stop_reason=f"converged at step {settled + 1} of {len(heights)}: after it 99 % of the "
        "pixels "
        "change by less than 1/255 of the indentation range",
        descriptions=tuple(
            f"noise level {s.sigma:.3g}, {d:.3g} mm (rms) from the last step"
            for s, d in zip(touch.steps, last_mm, strict=True)
        ),
    )


def _summarise_poses(touch: GeneratedTouch) -> StepHistory:
    """Distance of every pose's touch from the best one's."""
    best = touch.steps[-1].membrane.indentation_mm
    off_mm = tuple(_rms_mm(step.membrane.indentation_mm - best) for step in touch.steps)
    return StepHistory(
        curves=(StepCurve(name="from the best pose", unit="mm", values=off_mm),),
        stop_reason=f"{len(off_mm)} poses of the object that explain the source, each pressed "
        "into the target",
        descriptions=tuple(
            f"pose {k + 1}, {mm:.3g} mm (rms) from the best one" for k, mm in enumerate(off_mm)
        ),
    )


def _rms_mm(gap: Floats) -> float:
    return float(np.sqrt((gap.astype(np.float64) ** 2).mean()))


TOUCH = View(
    legend="target's membrane",
    make_preview=_draw_touch,
    make_layers=_layer_touch,
    trace_point=_trace_touch,
    split_steps=_split_steps,
    summarise_steps=_summarise_steps,
)
