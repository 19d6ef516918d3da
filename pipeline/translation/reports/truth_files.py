"""What is known of the truth of one frame, as files of a folder.

truth.npz          every array of the true value of each stage, as `stage.field`
difference.npz     computed less truth of each stage's image, in its unit; of colours in grey levels
truth.png          truth over difference of each stage
attribution.json   shares of the error in contact of the touch's depth
"""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.core.figures import make_figure, save_figure
from pipeline.core.files import write_arrays, write_json
from pipeline.core.progress import SILENT, Progress
from pipeline.translation.error_attribution import DEFAULT_METRIC, attribute_error
from pipeline.translation.reports.report import collect_value_arrays
from pipeline.translation.reports.sheet import draw_panel
from pipeline.translation.translate import Translation
from pipeline.translation.translated_frame import FrameReport
from pipeline.translation.truth_view import TruthView, build_truth_view

_PANEL_IN = 4.0  # width of a panel
_ROWS_BOTTOM = 0.56, 0.09  # of the truth and of the difference, as shares of the figure's height
_ROW_HEIGHT = 0.34


def write_truth(
    folder: Path,
    report: FrameReport,
    translation: Translation,
    frame: int,
    progress: Progress = SILENT,
) -> None:
    """Write what is known of the truth of frame `frame`, nothing where none is.

    `report` says what was computed.
    """
    truths = translation.read_true_outputs(frame)
    if not truths:
        return
    arrays = {name: collect_value_arrays(name, value) for name, value in truths.items()}
    write_arrays(
        folder / "truth.npz",
        {key: array for each in arrays.values() for key, array in each.items()},
    )
    views = _build_views(report, translation, truths)
    gaps: dict[str, NDArray[np.float32]] = {
        name: view.difference_to_truth.values
        for name, view in views.items()
        if view.difference_to_truth is not None and view.difference_to_truth.values is not None
    }
    write_arrays(folder / "difference.npz", gaps)
    _draw(folder / "truth.png", report, translation, views)
    if DEFAULT_METRIC in report.metrics:
        attribution = attribute_error(translation, frame, progress=progress)
        if attribution is not None:
            write_json(folder / "attribution.json", {**asdict(attribution), "frame": report.index})


def _build_views(
    report: FrameReport, translation: Translation, truths: Mapping[str, object]
) -> dict[str, TruthView]:
    seen = translation.make_preview_context(report.results)
    views: dict[str, TruthView] = {}
    for name, value in seen.outputs.items():
        view = translation.catalogue.views[name]
        truth_view = build_truth_view(name, view, view.make_preview(value, seen), truths, seen)
        if truth_view is not None:
            views[name] = truth_view
    return views


def _draw(
    path: Path, report: FrameReport, translation: Translation, views: Mapping[str, TruthView]
) -> None:
    count = len(views)
    figure = make_figure(figsize=(_PANEL_IN * count, 7.0), dpi=90)
    for column, (name, view) in enumerate(views.items()):
        title = translation.catalogue.stage(name).title
        pair = ((view.truth, f"{title}, truth"), (view.difference_to_truth, f"{title}, difference"))
        for bottom, (preview, text) in zip(_ROWS_BOTTOM, pair, strict=True):
            if preview is not None:
                axes = figure.add_axes(((0.07 + column) / count, bottom, 0.76 / count, _ROW_HEIGHT))
                draw_panel(figure, axes, preview, text)
    figure.suptitle(
        f"frame {report.index}   {translation.source.name} → {translation.target.name}", fontsize=11
    )
    save_figure(figure, path, "the truth's sheet")
