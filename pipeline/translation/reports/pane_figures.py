"""One pane of the window as a figure: image with scale bar, colour bar and caption."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.core.arrays import Floats, Image
from pipeline.core.errors import SettingProblem
from pipeline.core.figures import make_figure
from pipeline.core.graph import StageResult
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import Cloud
from pipeline.translation.reports.export_request import SOURCE, PaneContent
from pipeline.translation.translate import Translation
from pipeline.views.difference import compute_difference
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import (
    PixelPositions,
    Preview,
    compute_rest_depth_mm,
    make_recorded_preview,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_INCHES = (5.6, 4.6)
_DPI = 150
_AXES = (0.04, 0.13, 0.8, 0.77)


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderedPane:
    """One pane of one frame."""

    title: str
    preview: Preview
    points_mm: Floats  # (n, 3) its points, in the frame of its sensor
    rgb: Image  # (n, 3) their colours


def render_pane(
    name: str,
    frame: TactileFrame,
    results: Mapping[str, StageResult],
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
        true = view.make_preview(value, replace(seen, outputs={**seen.outputs, **truths}))
        picture = true if shown == "truth" else _less(picture, true, name)
    points_mm, rgb = _points(value, picture)
    return RenderedPane(title=title, preview=picture, points_mm=points_mm, rgb=rgb)


def draw_pane_figure(shown: RenderedPane, about: str) -> Figure:
    """Return a figure of a pane, with a line `about` its origin."""
    from pipeline.translation.reports.sheet import draw_panel

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


def _less(made: Preview, true: Preview, name: str) -> Preview:
    gap = compute_difference(made, true)
    if gap is None:
        raise SettingProblem(
            f"what was worked out of {name} and its truth cannot be subtracted; show one of them"
        )
    return gap


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
