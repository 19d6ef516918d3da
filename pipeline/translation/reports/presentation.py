"""A frame as it is presented: source, scene, generated touch and recorded touch on one picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pipeline.core.graph import StageResult, StageResults
from pipeline.core.values.frames import TactileFrame
from pipeline.translation.reports.export_request import SOURCE
from pipeline.translation.reports.scene_film import (
    INK,
    make_dark_figure,
    make_frame_scene,
    name_sensors,
)
from pipeline.translation.reports.sheet import render_pane
from pipeline.translation.translate import Translation
from pipeline.views.colours import get_colour_table
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import Preview

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PRESENTED_PX = (1920, 1080)
_GENERATED = "touch"
_N_COLUMNS = 3
# shares of the picture: gap, room for titles and for colour bars
_GAP = 0.012
_ABOVE = 0.06
_BELOW = 0.06
_TITLE = 1.25  # size of titles in points, of a picture 1 inch high
_Place = tuple[float, float, float, float]  # left, lower edge, width and height, as shares


def name_pane(translation: Translation, stage: str, result: StageResult | None) -> str:
    """Return the sensor of a stage, or of the source, what is shown of it, and which method
    answered.
    """
    if stage == SOURCE:
        return f"{translation.source.title}, recorded"
    by = "" if result is None else result.answered_by
    by = ", ".join(filter(None, (by, translation.truth_label)))
    title = translation.catalogue.stage(stage).title.lower()
    return f"{translation.get_sensor(stage).title}, {title}: {by}"


def draw_presentation(
    frame: TactileFrame,
    results: StageResults,
    translation: Translation,
    display: DisplayParams,
    size_px: tuple[int, int],
) -> Figure:
    """Return source, scene and generated touch side by side, and the recorded touch if known."""
    stage = _GENERATED if _GENERATED in results else translation.stages[-1]
    titles = [name_pane(translation, name, results.get(name)) for name in (SOURCE, stage)]
    panes = [render_pane(name, frame, results, translation, display) for name in (SOURCE, stage)]
    if stage in translation.read_true_outputs(frame.index, (stage,)):
        titles.append(f"{translation.get_sensor(stage).title}, recorded")
        panes.append(render_pane(stage, frame, results, translation, display, "truth"))
    pictures = [pane.preview for pane in panes]
    width, height = size_px
    figure = make_dark_figure(size_px)
    scene = make_frame_scene(frame, results, translation, display)
    rows = len(pictures) - 1  # generated over recorded
    cells = [(0, 0, 1), *((2, row, rows) for row in range(rows))]
    for (column, row, n_rows), title, picture in zip(cells, titles, pictures, strict=True):
        place = _lay_out((column, row, n_rows), picture.pixels.shape, size_px)
        axes = figure.add_axes(place)
        axes.set_axis_off()
        axes.imshow(picture.pixels, aspect="auto", interpolation="nearest")
        _write_title(figure, title, place)
        _draw_scale(figure, picture, place)
    place = left, below, wide, tall = _lay_out((1, 0, 1), None, size_px)
    axes = figure.add_axes((left, below, wide, tall))
    axes.set_axis_off()
    axes.imshow(scene.draw_image((round(wide * width), round(tall * height))), aspect="auto")
    _write_title(figure, name_sensors(translation), place)
    return figure


def _lay_out(
    cell: tuple[int, int, int], shape: tuple[int, ...] | None, size_px: tuple[int, int]
) -> _Place:
    """Return the largest place of an image of this shape in a cell: column, row and number of
    rows; None fills it.
    """
    column, row, n_rows = cell
    wide = (1.0 - _GAP) / _N_COLUMNS - _GAP
    tall = 1.0 / n_rows - _ABOVE - _BELOW
    left, below = _GAP + column * (wide + _GAP), 1.0 - (row + 1) / n_rows + _BELOW
    if shape is None:
        return left, below, wide, tall
    scale = min(wide * size_px[0] / shape[1], tall * size_px[1] / shape[0])
    fitted = scale * shape[1] / size_px[0], scale * shape[0] / size_px[1]
    return left + 0.5 * (wide - fitted[0]), below + 0.5 * (tall - fitted[1]), *fitted


def _write_title(figure: Figure, title: str, place: _Place) -> None:
    left, below, wide, tall = place
    at = left + 0.5 * wide, below + tall + 0.012
    size = _TITLE * figure.get_figheight()
    figure.text(*at, title, color=INK, fontsize=size, ha="center", va="bottom")


def _draw_scale(figure: Figure, picture: Preview, place: _Place) -> None:
    """Draw the colour bar of a picture with its limits under it."""
    scale = picture.scale
    if scale is None:
        return
    left, below, wide, _ = place
    bar = figure.add_axes((left + 0.25 * wide, below - 0.03, 0.5 * wide, 0.015))
    bar.set_axis_off()
    bar.imshow(np.array(get_colour_table(scale.colour_map))[None], aspect="auto")
    text = f"{scale.low:g} to {scale.high:g} {scale.unit}"
    at = left + 0.5 * wide, below - 0.04
    figure.text(*at, text, color=INK, ha="center", va="top")
