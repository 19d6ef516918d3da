"""One pixel followed through every stage, forward and back, by the index maps that the stages hand on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.engine.graph import StageResult
from pipeline.values.results import Cloud, DepthMap, ObjectPose, TargetView, Touch

T = TypeVar("T")

SAME_SURFACE_MM = 0.2  # a point this close behind the seen surface is part of it, not hidden by it


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """Where a traced pixel is in one stage."""

    stage: str  # "source" or the name of a stage
    index: int  # flat index into that stage's elements, -1 = it does not get there
    row: int  # of an image, -1 where the stage is a cloud
    col: int
    point_mm: tuple[float, float, float] | None
    text: str  # what is there, or why the trace ends


def forward(results: Mapping[str, StageResult], row: int, col: int) -> tuple[Mark, ...]:
    """Marks of source pixel (row, col) in every stage that was evaluated, up to where it ends."""
    marks = [Mark(stage="source", index=-1, row=row, col=col, point_mm=None, text=f"({col}, {row})")]
    depth = _output(results, "depth", DepthMap)
    if depth is None:
        return tuple(marks)
    pixel = row * depth.contact.shape[1] + col
    marks.append(_in_depth(depth, pixel))
    if not depth.contact.flat[pixel]:
        return tuple(marks)
    cloud = _output(results, "adapt", Cloud)
    if cloud is None:
        return tuple(marks)
    point = _first(cloud.source_index, pixel)
    marks.append(_in_cloud(cloud, point))
    view = _output(results, "project", TargetView)
    if point < 0 or view is None:
        return tuple(marks)
    view_mark = _in_view(view, cloud.points_mm[point])
    marks.append(view_mark)
    target = view_mark.index
    touch = _output(results, "generate", Touch)
    if target < 0 or touch is None:
        return tuple(marks)
    marks.append(_in_touch(touch, target))
    pose = _output(results, "pose", ObjectPose)
    if pose is not None:
        marks.append(_in_pose(pose, target))
    return tuple(marks)


def backward(results: Mapping[str, StageResult], row: int, col: int) -> tuple[Mark, ...]:
    """Marks of target pixel (row, col) back to the source; empty when nothing came there."""
    view, cloud = _output(results, "project", TargetView), _output(results, "adapt", Cloud)
    if view is None or cloud is None:
        return ()
    point = int(view.source_index[row, col])
    if point < 0:
        return ()
    return forward_from_pixel(results, int(cloud.source_index[point]))


def forward_from_pixel(results: Mapping[str, StageResult], pixel: int) -> tuple[Mark, ...]:
    """As `forward`, from a flat source pixel."""
    depth = _output(results, "depth", DepthMap)
    cols = depth.contact.shape[1] if depth is not None else 1
    return forward(results, *divmod(pixel, cols))


def sentence(marks: tuple[Mark, ...]) -> str:
    """The trace in one line, such as `(142, 88) -> 0.83 mm -> (3.1, -0.4, 24.2) mm -> ...`."""
    return " → ".join(mark.text for mark in marks)


def _output(results: Mapping[str, StageResult], name: str, kind: type[T]) -> T | None:
    result = results.get(name)
    return result.output if result is not None and isinstance(result.output, kind) else None


def _first(index_map: NDArray[np.int32], wanted: int) -> int:
    found = np.flatnonzero(index_map == wanted)
    return int(found[0]) if found.size else -1


def _in_depth(depth: DepthMap, pixel: int) -> Mark:
    row, col = divmod(pixel, depth.contact.shape[1])
    value = float(depth.indentation_mm[row, col])
    z = float(depth.depth_mm[row, col])
    rx, ry = depth.camera.rays()
    if not np.isfinite(value):
        text = "no depth reading here"
    elif not depth.contact[row, col]:
        text = f"{value:.3f} mm, not in contact"
    else:
        text = f"{value:.3f} mm"
    point = (float(rx[col]) * z, float(ry[row]) * z, z)
    return Mark(stage="depth", index=pixel, row=row, col=col, point_mm=point if np.isfinite(z) else None, text=text)


def _in_cloud(cloud: Cloud, point: int) -> Mark:
    if point < 0:
        return Mark(stage="adapt", index=-1, row=-1, col=-1, point_mm=None, text="thinned out of the cloud")
    x, y, z = (float(v) for v in cloud.points_mm[point])
    return Mark(stage="adapt", index=point, row=-1, col=-1, point_mm=(x, y, z), text=f"({x:.2f}, {y:.2f}, {z:.2f}) mm")


def _in_view(view: TargetView, point_mm: NDArray[np.float32]) -> Mark:
    """The target pixel that a cloud point falls on: several points may share one where the target is coarser."""
    where = (float(point_mm[0]), float(point_mm[1]), float(point_mm[2]))
    x_px, y_px, visible = (a[0] for a in view.camera.project(point_mm[None, :]))
    if not visible:
        out_x = max(-x_px, x_px - view.camera.cols + 1, 0.0)
        out_y = max(-y_px, y_px - view.camera.rows + 1, 0.0)
        text = f"outside the target image by {max(out_x, out_y):.0f} px"
        return Mark(stage="project", index=-1, row=-1, col=-1, point_mm=where, text=text)
    row, col = int(np.floor(y_px + 0.5)), int(np.floor(x_px + 0.5))
    seen_mm = float(view.depth_mm[row, col])
    if not np.isfinite(seen_mm):
        text = f"target ({col}, {row}), cut away at a depth jump"
        return Mark(stage="project", index=-1, row=row, col=col, point_mm=where, text=text)
    if where[2] > seen_mm + SAME_SURFACE_MM:
        text = f"hidden in target ({col}, {row}) behind what is {where[2] - seen_mm:.2f} mm nearer"
        return Mark(stage="project", index=-1, row=row, col=col, point_mm=where, text=text)
    pushed = float(view.indentation_mm[row, col])
    state = f"{pushed:.3f} mm in" if view.contact[row, col] else "does not reach the membrane"
    index = row * view.camera.cols + col
    return Mark(stage="project", index=index, row=row, col=col, point_mm=where, text=f"target ({col}, {row}), {state}")


def _in_touch(touch: Touch, target: int) -> Mark:
    row, col = divmod(target, touch.contact.shape[1])
    if touch.image.ndim == 2:
        text = f"generated {float(touch.image[row, col]):.2f} mm"
    else:
        r, g, b = (int(v) for v in touch.image[row, col])
        text = f"generated rgb {r} {g} {b}"
    return Mark(stage="generate", index=target, row=row, col=col, point_mm=None, text=text)


def _in_pose(pose: ObjectPose, target: int) -> Mark:
    point = _first(pose.source_index, target)
    if point < 0:
        return Mark(stage="pose", index=-1, row=-1, col=-1, point_mm=None, text="not among the registered points")
    x, y, z = (float(v) for v in pose.scene_mm[point])
    return Mark(
        stage="pose",
        index=point,
        row=-1,
        col=-1,
        point_mm=(x, y, z),
        text=f"registered at ({x:.2f}, {y:.2f}, {z:.2f}) mm",
    )
