"""All stages of one frame side by side on one sheet, with units and scale bars.

One pane of the window as a figure: image with scale bar, colour bar and caption.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.core.arrays import Floats, Image
from pipeline.core.errors import SettingProblem
from pipeline.core.figures import make_figure, save_figure
from pipeline.core.frozen import frozen
from pipeline.core.graph import StageResult, StageResults
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import Cloud
from pipeline.translation.reports.export_request import SOURCE, PaneContent
from pipeline.translation.translate import Translation
from pipeline.translation.translated_frame import FrameReport
from pipeline.translation.truth_view import build_truth_view
from pipeline.views.colours import ColourScale, get_colour_table
from pipeline.views.display_params import DisplayParams
from pipeline.views.drawing import Line, list_outlines, make_scale_bar
from pipeline.views.preview import (
    PixelPositions,
    Preview,
    compute_rest_depth_mm,
    make_recorded_preview,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_POINTS_PER_PX = 72.0 / 96.0
_PANEL_IN = 3.5  # width of a panel
DEFAULT_DISPLAY = DisplayParams()


def write_sheet(
    path: Path, frame: TactileFrame, report: FrameReport, translation: Translation
) -> None:
    """Write the columns of the window as one PNG."""
    save_figure(draw_sheet(frame, report, translation), path, "the sheet")


def draw_sheet(
    frame: TactileFrame,
    report: FrameReport,
    translation: Translation,
    *,
    display: DisplayParams = DEFAULT_DISPLAY,
    timed: bool = True,
) -> Figure:
    """Return the columns of the window as one figure; `timed` adds times and cache states."""
    source = translation.source
    n = 1 + len(translation.stages)
    figure = make_figure(figsize=(_PANEL_IN * n, 4.3), dpi=90)
    # Fixed positions: an automatic layout costs more time than all the drawing.
    axes = [figure.add_axes(((0.07 + i) / n, 0.2, 0.76 / n, 0.6)) for i in range(n)]
    draw_panel(
        figure,
        axes[0],
        make_recorded_preview(frame, source, display)[0],
        f"Source · {source.title}",
    )
    seen = translation.make_preview_context(report.results, display)
    for ax, name in zip(axes[1:], translation.stages, strict=True):
        stage = translation.catalogue.stage(name)
        result = report.results.get(name)
        if result is None:
            ax.set_axis_off()
            continue
        title = stage.title if result.method is None else f"{stage.title} · {result.answered_by}"
        draw_panel(
            figure, ax, translation.catalogue.views[name].make_preview(result.output, seen), title
        )
        _footer(ax, result, timed=timed)
    sensors = f"{source.name} → {translation.target.name}"
    words = "   ".join(filter(None, (f"frame {report.index}", sensors, translation.truth_label)))
    figure.suptitle(words, fontsize=11, y=0.985)
    figure.text(0.5, 0.925, _figures(report), fontsize=8, ha="center", va="top", color="0.3")
    return figure


def draw_panel(figure: Figure, ax: Axes, picture: Preview, title: str) -> None:
    """Draw a preview with outlines, scale bar, caption and colour bar."""
    ax.imshow(picture.pixels, interpolation="nearest")
    ax.set_title(title, fontsize=10)
    ax.set(xticks=[], yticks=[])
    rows, cols = picture.pixels.shape[:2]
    for line in list_outlines(picture):
        _draw_line(ax, line)
    bar = make_scale_bar(picture, (0.0, 0.0, cols, rows))
    if bar is not None:
        _draw_line(ax, bar.line)
        x, y = bar.line.points_px.mean(axis=0) - 0.5
        ax.annotate(
            bar.text,
            (x, y),
            (0, 2),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            color=_to_hex(bar.line),
        )
    ax.set_xlim(-0.5, cols - 0.5)
    ax.set_ylim(rows - 0.5, -0.5)
    ax.text(
        0.0,
        -0.06,
        picture.caption[:64],
        transform=ax.transAxes,
        fontsize=7.5,
        va="top",
        color="0.3",
    )
    if picture.scale is not None:
        _colour_bar(figure, ax, picture.scale)


def _colour_bar(figure: Figure, ax: Axes, scale: ColourScale) -> None:
    box = ax.get_position()
    bar = figure.add_axes((box.x1 + 0.004, box.y0 + 0.1, 0.005, box.height - 0.2))
    colours = get_colour_table(scale.colour_map)[:, None, :]
    bar.imshow(colours, origin="lower", aspect="auto", extent=(0.0, 1.0, scale.low, scale.high))
    bar.set_xticks([])
    bar.yaxis.tick_right()
    bar.set_title(f"({scale.unit})", fontsize=7, loc="left")
    bar.tick_params(labelsize=7)


def _draw_line(ax: Axes, line: Line) -> None:
    x, y = line.points_px.T - 0.5
    ax.plot(
        x,
        y,
        color=_to_hex(line),
        alpha=line.opacity,
        lw=_POINTS_PER_PX * line.width,
        solid_capstyle="butt",
    )


def _to_hex(line: Line) -> str:
    return "#{:02x}{:02x}{:02x}".format(*line.rgb)


def _footer(ax: Axes, result: StageResult, *, timed: bool) -> None:
    """Write time, state and the first warning, or else note, below a panel."""
    notes = result.warnings or result.notes
    lines = (
        [f"{result.ms:.2f} ms · {'warning' if result.warnings else result.state}"] if timed else []
    )
    lines += [notes[0][:62]] if notes else []
    ax.text(0.0, -0.13, "\n".join(lines), transform=ax.transAxes, fontsize=7.5, va="top")


def _figures(report: FrameReport) -> str:
    """Return the metrics of the frame as text, those of the pose on a line of their own."""
    lines = (
        "   ".join(
            f"{k} {v:.3g}" for k, v in report.metrics.items() if k.startswith("pose.") == of_pose
        )
        for of_pose in (False, True)
    )
    return "\n".join(lines)


_INCHES = (5.6, 4.6)
_DPI = 150
_AXES = (0.04, 0.13, 0.8, 0.77)


@frozen
class RenderedPane:
    """One pane of one frame."""

    title: str
    preview: Preview
    points_mm: Floats  # (n, 3) its points, in the frame of its sensor
    rgb: Image  # (n, 3) their colours


def render_pane(
    name: str,
    frame: TactileFrame,
    results: StageResults,
    translation: Translation,
    display: DisplayParams,
    shown: PaneContent = "computed",
) -> RenderedPane:
    """Return the pane of a stage or of the source.

    Raises SettingProblem where the requested truth is unknown.
    """
    if name == SOURCE:
        return _reading(frame, translation, display)
    stage = translation.catalogue.stage(name)
    seen = translation.make_preview_context(results, display)
    value = results[name].output
    view = translation.catalogue.views[name]
    picture = view.make_preview(value, seen)
    title = ", ".join(
        filter(None, (f"{stage.title} · {results[name].answered_by}", translation.truth_label))
    )
    if shown != "computed":
        truths = translation.read_true_outputs(frame.index)
        if name not in truths:
            raise SettingProblem(
                f"the truth of {name} is not known of frame {frame.index} of this recording"
            )
        value = truths[name]
        title = f"{title}, {shown}"
        true = build_truth_view(name, view, picture, truths, seen)
        assert true is not None
        drawn = true.truth if shown == "truth" else true.difference_to_truth
        if drawn is None:
            raise SettingProblem(
                f"what was computed of {name} and its truth cannot be subtracted; show one of them"
            )
        picture = drawn
    points_mm, rgb = _points(value, picture)
    return RenderedPane(title=title, preview=picture, points_mm=points_mm, rgb=rgb)


def draw_pane_figure(shown: RenderedPane, about: str) -> Figure:
    """Return a figure of a pane, with a line `about` its origin."""
    drawn = make_figure(figsize=_INCHES, dpi=_DPI)
    draw_panel(drawn, drawn.add_axes(_AXES), shown.preview, f"{shown.title} · {about}")
    return drawn


def _reading(frame: TactileFrame, translation: Translation, display: DisplayParams) -> RenderedPane:
    sensor = translation.source
    picture, camera = make_recorded_preview(frame, sensor, display)
    surface = frame.image if frame.is_depth else compute_rest_depth_mm(sensor, camera)
    laid = replace(picture, positions_mm=PixelPositions(camera, np.asarray(surface, np.float32)))
    points_mm, rgb = _points(None, laid)
    return RenderedPane(title="Source", preview=picture, points_mm=points_mm, rgb=rgb)


def _points(value: Any, picture: Preview) -> tuple[Floats, Image]:
    """Return all points of the value, coloured as in its preview."""
    if isinstance(value, Cloud):
        grey = np.full((len(value.points_mm), 3), 128, np.uint8)
        if picture.element_index is not None:
            there = picture.element_index >= 0
            grey[picture.element_index[there]] = picture.pixels[there]
        return value.points_mm, grey
    places = picture.compute_positions_mm()
    if places is None:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)
    known = np.isfinite(places).all(axis=-1)
    return places[known], picture.pixels[known]
