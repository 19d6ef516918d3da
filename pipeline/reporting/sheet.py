"""All stages of one frame side by side on one picture, with units and scale bars."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Mask
from pipeline.base.files import whole_file
from pipeline.engine.graph import StageResult
from pipeline.reporting.frame_report import FrameReport
from pipeline.sensors.spec import SensorSpec
from pipeline.translation.translate import Translation
from pipeline.values.frames import TactileFrame
from pipeline.values.results import Cloud, DepthMap, ObjectPose, TargetView, Touch

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

MAX_DRAWN_POINTS = 6000  # more do not show on a panel of this size
_BAR_LENGTHS_MM = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)


def write_sheet(path: Path, frame: TactileFrame, report: FrameReport, translation: Translation) -> None:
    """Draw the six panels of the window as one PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(21, 4.3), dpi=90)
    FigureCanvasAgg(figure)
    # Fixed places: an automatic layout costs more time than all the drawing.
    axes = [figure.add_axes((0.012 + i / 6.0, 0.2, 0.126, 0.6)) for i in range(6)]
    source, target = translation.source, translation.target
    _picture(figure, axes[0], frame.image, source, f"Source · {source.title}")
    drawers = (_depth, _cloud, _view, _touch, _pose)
    names = ("depth", "adapt", "project", "generate", "pose")
    for ax, name, draw in zip(axes[1:], names, drawers, strict=True):
        result = report.results.get(name)
        if result is None:
            ax.set_axis_off()
            continue
        draw(figure, ax, result, source if name == "depth" else target)
        _footer(ax, result)
    touch, pose = (
        "   ".join(f"{k} {v:.3g}" for k, v in report.metrics.items() if k.startswith("pose.") == of_pose)
        for of_pose in (False, True)
    )
    figure.suptitle(f"frame {report.index}   {source.name} → {target.name}", fontsize=11, y=0.985)
    figure.text(0.5, 0.925, f"{touch}\n{pose}", fontsize=8, ha="center", va="top", color="0.3")
    with whole_file(path, "the sheet") as file:
        figure.savefig(file, format="png")


def _colour_bar(figure: Figure, ax: Axes, drawn: ScalarMappable, label: str) -> None:
    box = ax.get_position()
    beside = figure.add_axes((box.x1 + 0.004, box.y0 + 0.1, 0.005, box.height - 0.2))
    figure.colorbar(drawn, cax=beside)
    beside.set_title(label, fontsize=7, loc="left")
    beside.tick_params(labelsize=7)


def _depth(figure: Figure, ax: Axes, result: StageResult, sensor: SensorSpec) -> None:
    depth: DepthMap = result.output
    _height(figure, ax, depth.indentation_mm, depth.contact, sensor)
    ax.set_title("Depth · indentation, + toward camera", fontsize=10)


def _cloud(figure: Figure, ax: Axes, result: StageResult, sensor: SensorSpec) -> None:
    cloud: Cloud = result.output
    points = cloud.points_mm[:: max(1, len(cloud.points_mm) // MAX_DRAWN_POINTS)]
    ax.set_title(f"Adapted cloud · {len(cloud.points_mm)} points, {sensor.name} frame", fontsize=10)
    if not len(points):
        _say(ax, "no contact")
        return
    _millimetre_axes(ax)
    drawn = ax.scatter(points[:, 0], points[:, 1], c=points[:, 2], s=2, cmap="viridis", linewidths=0)
    _colour_bar(figure, ax, drawn, "z (mm)")


def _view(figure: Figure, ax: Axes, result: StageResult, sensor: SensorSpec) -> None:
    view: TargetView = result.output
    shown = np.where(np.isfinite(view.depth_mm), view.indentation_mm, np.nan)
    _height(figure, ax, shown, view.contact, sensor)
    ax.set_title("Target depth and mask · indentation", fontsize=10)


def _touch(figure: Figure, ax: Axes, result: StageResult, sensor: SensorSpec) -> None:
    touch: Touch = result.output
    if touch.image.ndim == 2:
        _height(figure, ax, touch.indentation_mm, touch.contact, sensor)
        ax.set_title(f"Generated touch · {sensor.title}, imprint", fontsize=10)
    else:
        _picture(figure, ax, touch.image, sensor, f"Generated touch · {sensor.title}")


def _pose(figure: Figure, ax: Axes, result: StageResult, sensor: SensorSpec) -> None:  # noqa: ARG001 - one signature
    pose: ObjectPose = result.output
    ax.set_title("Object pose", fontsize=10)
    if pose.sensor_from_object is None:
        _say(ax, "no pose")
        return
    _millimetre_axes(ax)
    points = pose.scene_mm[:: max(1, len(pose.scene_mm) // MAX_DRAWN_POINTS)]
    ax.scatter(points[:, 0], points[:, 1], c="#0072B2", s=2, linewidths=0, label="touched points")
    origin, axes = pose.sensor_from_object[:3, 3], pose.sensor_from_object[:3, :3]
    for i, colour in enumerate(("#D55E00", "#009E73", "#56B4E9")):
        tip = origin + 5.0 * axes[:, i]
        ax.plot([origin[0], tip[0]], [origin[1], tip[1]], color=colour, lw=2, label=f"object {'xyz'[i]}, 5 mm")
    ax.legend(fontsize=7, loc="upper right")
    ax.set_title(f"Object pose · rms {pose.rmse_mm:.3f} mm, {100 * pose.fitness:.0f} % matched", fontsize=10)


def _height(figure: Figure, ax: Axes, height_mm: NDArray[Any], contact: Mask, sensor: SensorSpec) -> None:
    """A height map under absolute colour limits, with the outline of the contact."""
    top = min(2.0, sensor.limits.indentation_max_mm) if sensor.kind == "gel" else 10.0
    drawn = ax.imshow(height_mm, cmap="viridis", vmin=0.0, vmax=top, interpolation="nearest")
    _colour_bar(figure, ax, drawn, "(mm)")
    if contact.any() and not contact.all():
        ax.contour(contact.astype(np.float32), levels=[0.5], colors="#E69F00", linewidths=1.0)
    _scale_bar(ax, height_mm.shape[1], sensor)


def _picture(figure: Figure, ax: Axes, image: NDArray[Any], sensor: SensorSpec, title: str) -> None:
    if image.ndim == 2:
        low, high = float(sensor.rest_depth_mm.min()) - 15.0, float(sensor.rest_depth_mm.max()) + 5.0
        drawn = ax.imshow(image, cmap="cividis", vmin=low, vmax=high, interpolation="nearest")
        _colour_bar(figure, ax, drawn, "z (mm)")
    else:
        ax.imshow(image, interpolation="nearest")
    ax.set_title(title, fontsize=10)
    _scale_bar(ax, image.shape[1], sensor)


def _scale_bar(ax: Axes, cols: int, sensor: SensorSpec) -> None:
    """A bar of a round length, about a fifth of the image wide, under the image."""
    mm_per_px = sensor.pixel_mm * sensor.camera.cols / cols
    wanted = cols * mm_per_px / 5.0
    length_mm = min(_BAR_LENGTHS_MM, key=lambda length: abs(length - wanted))
    share = length_mm / mm_per_px / cols
    ax.set_xticks([])
    ax.set_yticks([])
    ax.plot([0.0, share], [-0.035, -0.035], transform=ax.transAxes, color="black", lw=2, clip_on=False)
    ax.text(share + 0.02, -0.035, f"{length_mm:g} mm", transform=ax.transAxes, fontsize=8, va="center")


def _millimetre_axes(ax: Axes) -> None:
    ax.set_aspect("equal", adjustable="datalim")
    ax.invert_yaxis()
    ax.set_xlabel("x (mm)", fontsize=8)
    ax.set_ylabel("y (mm)", fontsize=8)
    ax.tick_params(labelsize=7)


def _say(ax: Axes, text: str) -> None:
    ax.set_xticks([])
    ax.set_yticks([])
    ax.text(0.5, 0.5, text, transform=ax.transAxes, ha="center", va="center", color="0.4")


def _footer(ax: Axes, result: StageResult) -> None:
    """Time, state and the first note below a panel."""
    note = f"\n{result.notes[0][:62]}" if result.notes else ""
    below = -0.2 if ax.get_xlabel() else -0.11
    ax.text(0.0, below, f"{result.ms:.2f} ms · {result.state}{note}", transform=ax.transAxes, fontsize=7.5, va="top")
