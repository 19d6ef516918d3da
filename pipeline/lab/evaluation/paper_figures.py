"""The paper's figures 4 and 5: touches of one split by T2T and T2D2, between the source's frame
and the recorded touch.

Figure 4 shows both directions between GelSlim and Soft Bubble, figure 5 the target depth of T2D2
for every direction.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.core.arrays import Image
from pipeline.core.figures import make_figure, save_figure
from pipeline.core.frozen import frozen
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.lab.evaluation.held_out import (
    Candidate,
    PressRecordings,
    select_candidates,
)
from pipeline.lab.evaluation.paper_tables import (
    EvaluationRequest,
    collect_touches,
)
from pipeline.lab.evaluation.touch_scoring import choose_candidate, open_presses
from pipeline.sensors.spec import load_sensor
from pipeline.translation.translate import Translation
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import make_recorded_preview

INPUT = "input"
DEPTH = "target depth"
TRUTH = "recorded touch"
T2T = "T2T"
T2D2 = "T2D2"
_COLUMNS = {4: (INPUT, T2T, T2D2, TRUTH), 5: (INPUT, DEPTH, T2D2, TRUTH)}
_N_OBJECTS = 2  # rows of a direction
_PANEL_INCHES = 1.9, 1.5  # width and height


@frozen
class FigureRow:
    """One touch in one direction."""

    source: str
    target: str
    object_name: str
    images: Mapping[str, Image]  # column -> (rows, cols, 3); without models that have no weights


def draw_paper_figures(
    request: EvaluationRequest, folder: Path, progress: Progress = SILENT
) -> list[Path]:
    """Write `figure_4_<split>.png` and `figure_5_<split>.png`.

    Returns the files. Raises FileProblem.
    """
    touches, _ = collect_touches(request, SILENT)
    rows: list[FigureRow] = []
    for k, ((source, target), (held_out, _)) in enumerate(touches.items()):
        progress.step(k / len(touches), f"figures of {source} to {target}")
        models = _select_models(request, source, target)
        rows += [_make_row(request, of, source, target, models) for of in _spread(held_out)]
    both = [row for row in rows if {row.source, row.target} == {"gelslim", "soft_bubble"}]
    drawn: list[Path] = []
    for number, of_figure in ((4, both), (5, rows)):
        if of_figure:
            drawn.append(folder / f"figure_{number}_{request.split}.png")
            _draw(of_figure, _COLUMNS[number], request.split.replace("_", " "), drawn[-1])
    return drawn


def _spread(held_out: Sequence[PressRecordings]) -> list[PressRecordings]:
    """The first and the middle object, or all if there are fewer."""
    step = max(1, len(held_out) // _N_OBJECTS)
    return list(held_out[::step][:_N_OBJECTS])


def _select_models(request: EvaluationRequest, source: str, target: str) -> dict[str, Candidate]:
    """The paper's model -> the first touch method of it that has weights."""
    found = select_candidates(load_sensor(source), load_sensor(target), (), request.weights)
    models: dict[str, Candidate] = {}
    for candidate in found.candidates:
        if candidate.paper_model:
            models.setdefault(candidate.paper_model, candidate)
    return models


def _make_row(
    request: EvaluationRequest,
    of: PressRecordings,
    source: str,
    target: str,
    models: Mapping[str, Candidate],
) -> FigureRow:
    with open_presses(of, source, target, request.methods) as translation:
        frames = of.frames or translation.select_paired(range(translation.n_frames))
        index = frames[len(frames) // 2]
        observed = translation.read_target_observation(index)
        assert observed is not None
        images = {INPUT: _draw_frame(translation.stream.frame(index), translation, source)}
        images[TRUTH] = _draw_frame(observed[0], translation, target)
        for model, candidate in models.items():
            images |= _draw_stages(request, translation, index, model, candidate)
    return FigureRow(source=source, target=target, object_name=of.object_name, images=images)


def _draw_frame(frame: TactileFrame, translation: Translation, name: str) -> Image:
    sensor = translation.source if translation.source.name == name else translation.target
    return make_recorded_preview(frame, sensor, DisplayParams())[0].pixels


def _draw_stages(
    request: EvaluationRequest,
    translation: Translation,
    index: int,
    model: str,
    candidate: Candidate,
) -> dict[str, Image]:
    """The touch of a model; with T2D2 its target depth too."""
    chosen = choose_candidate(translation, candidate.name, request.methods, request.weights)
    results = chosen.evaluate(index, ["target_depth", "touch"])
    context = chosen.make_preview_context(results)
    stages = {model: "touch"}
    if model == T2D2:
        stages[DEPTH] = "target_depth"
    return {
        title: chosen.catalogue.views[stage].make_preview(results[stage].output, context).pixels
        for title, stage in stages.items()
    }


def _draw(rows: Sequence[FigureRow], columns: Sequence[str], split: str, path: Path) -> None:
    width, height = _PANEL_INCHES
    figure = make_figure(
        figsize=(width * len(columns) + 1.0, height * len(rows) + 0.6),
        dpi=150,
        layout="constrained",
    )
    figure.suptitle(split, fontsize=9)
    panels: Any = figure.subplots(len(rows), len(columns), squeeze=False)
    for axes, column in zip(panels[0], columns, strict=True):
        axes.set_title(column, fontsize=8)
    for line, row in zip(panels, rows, strict=True):
        for axes, column in zip(line, columns, strict=True):
            axes.set(xticks=[], yticks=[])
            if column in row.images:
                axes.imshow(row.images[column])
            else:
                axes.set_xlabel("no weights", fontsize=7)
        titles = [load_sensor(name).title for name in (row.source, row.target)]
        line[0].set_ylabel(f"{titles[0]} to\n{titles[1]}\n{row.object_name}", fontsize=6)
    save_figure(figure, path, "the figure")
