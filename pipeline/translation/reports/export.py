"""Export one file of a translation, as the window shows it: image, points, arrays, table or video.

The window and the command line both call `export_file`, so that they write the same bytes.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.files import check_folder_for, open_atomic, require_separate, write_arrays
from pipeline.core.frame_lists import parse_frames
from pipeline.core.frozen import frozen
from pipeline.core.graph import StageResult, StageResults
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.pairing import compute_interval_s
from pipeline.translation import cross_section
from pipeline.translation.colour_limits import fit_display
from pipeline.translation.force import measure_force
from pipeline.translation.reports import scene_film, sheet
from pipeline.translation.reports.export_request import (
    PRESENTATION,
    SCENE,
    SHEET,
    SOURCE,
    ExportRequest,
)
from pipeline.translation.reports.presentation import PRESENTED_PX, draw_presentation
from pipeline.translation.reports.report import collect_stage_arrays
from pipeline.translation.reports.video import write_video
from pipeline.translation.translate import Translation, open_translation
from pipeline.translation.translated_frame import FrameReport

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pipeline.views.display_params import DisplayParams

T = TypeVar("T")
DEFAULT_VIDEO_RATE_HZ = 10.0  # of a video, where the recording has no timestamps
# width and height of a scene or presentation
_LEAST_PX = 64
_MOST_PX = 8192
_CACHE_BYTES = 32 * 1024 * 1024
# no dates in the files: the same content gives the same bytes
_UNDATED: Mapping[str, Mapping[str, None]] = {
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}


@frozen
class ExportOutcome:
    """What the reader of a written file should know."""

    # stages that another method or the recording's truth answered, and why
    fallbacks: tuple[str, ...]
    problems: tuple[str, ...]  # frames that could not be read and are left out, and why


def export_file(asked: ExportRequest, progress: Progress = SILENT) -> ExportOutcome:
    """Write the requested file, complete or not at all; of many frames, those that can be read.

    Raises TouchError.
    """
    suffix = asked.path.suffix.lower()
    if asked.section and suffix != ".csv":
        raise FileProblem("a section is written as a table, .csv", asked.path)
    write = _section if asked.section else _WRITERS.get(suffix)
    if write is None:
        raise FileProblem(
            f"nothing is written as this kind of file; known are {', '.join(_WRITERS)}", asked.path
        )
    request = asked.request
    inputs = (request.recording, request.reference, request.calibration, request.mesh)
    files = (file for _, file in request.weights)
    _check_options(asked)
    require_separate(asked.path, filter(None, (*inputs, request.alignment, *files)))
    check_folder_for(asked.path)
    with open_translation(
        request, settings=asked.stage_settings, cache_bytes=_CACHE_BYTES
    ) as translation:
        panes = (SHEET, SOURCE, *translation.stages)
        if write in (_picture, _video):
            panes = (SCENE, PRESENTATION, *panes)
        for pane in asked.pane.split(",") if asked.section else [asked.pane]:
            if pane not in panes:
                raise SettingProblem(
                    f"no pane {pane!r} as {asked.path.suffix} on this route; there are "
                    f"{', '.join(panes)}"
                )
        work = _Work(asked, translation, progress)
        write(work)
    problems = tuple(f"frame {index}: {problem}" for index, problem in work.problems.items())
    return ExportOutcome(fallbacks=tuple(sorted(work.replaced)), problems=problems)


def _check_options(asked: ExportRequest) -> None:
    """Refuse options that the pane has not, before anything is computed."""
    is_view = asked.pane in (SCENE, PRESENTATION)
    if is_view and asked.content != "computed":
        raise SettingProblem(
            f"a {asked.pane} has no {asked.content}; leave --content out, or name a stage as --pane"
        )
    if asked.size_px is None:
        return
    if not is_view:
        raise SettingProblem(
            f"only a {SCENE} or {PRESENTATION} has a size; leave --size out for {asked.pane}"
        )
    width, height = asked.size_px
    if not (_LEAST_PX <= width <= _MOST_PX and _LEAST_PX <= height <= _MOST_PX):
        raise SettingProblem(
            f"a size is {_LEAST_PX} to {_MOST_PX} pixels either way, got {width} x {height}"
        )


class _Work:
    """Open resources of one export."""

    def __init__(self, asked: ExportRequest, translation: Translation, progress: Progress) -> None:
        self.asked = asked
        self.translation = translation
        self.progress = progress
        self.replaced = {translation.truth_label} if translation.truth_label else set[str]()
        self.problems: dict[int, FileProblem] = {}

    @cached_property
    def display(self) -> DisplayParams:
        """Colour limits of all frames."""
        return fit_display(self.translation, self.asked.display_params, self.progress)

    @property
    def frame_indices(self) -> list[int]:
        """Frames of a table or a video."""
        return parse_frames(self.asked.frames, self.translation.n_frames)

    def make_each(self, make: Callable[[int], T]) -> Iterator[T]:
        """Yield what `make` returns for each requested frame.

        Those that cannot be read are noted and left out.
        """
        indices = self.frame_indices
        for done, index in enumerate(indices):
            self.progress.step(done / len(indices), f"frame {index}")
            try:
                made = make(index)
            except FileProblem as error:
                self.problems[index] = error
            else:
                yield made
        if len(self.problems) == len(indices):
            raise self.problems[indices[0]]

    def evaluate_frame(
        self, index: int, *, every: bool = False
    ) -> tuple[TactileFrame, dict[str, StageResult]]:
        """Return a frame and its stages up to the requested one, or `every` one."""
        stages = (SOURCE, *self.translation.stages)
        if self.asked.pane in stages and not every:
            stages = stages[: stages.index(self.asked.pane) + 1]
        stages = stages[1:]
        frame = self.translation.stream.frame(self.translation.check_index(index))
        results = self.translation.evaluate(frame, stages, self.progress) if stages else {}
        self.replaced |= {
            f"{name}: {result.fallback}" for name, result in results.items() if result.fallback
        }
        return frame, results

    def draw_figure(self, index: int) -> Figure:
        """Return the sheet or the pane of a frame."""
        frame, results = self.evaluate_frame(index)
        if self.asked.pane == SHEET:
            metrics = self.translation.compute_metrics(results, index)
            report = FrameReport(index=index, results=results, metrics=metrics)
            return sheet.draw_sheet(
                frame, report, self.translation, display=self.display, timed=False
            )
        if self.asked.pane == SCENE:
            return self.make_scene(frame, results).draw_figure(self.size_px)
        if self.asked.pane == PRESENTATION:
            return draw_presentation(frame, results, self.translation, self.display, self.size_px)
        time = f", {frame.time_s:.2f} s" if np.isfinite(frame.time_s) else ""
        return sheet.draw_pane_figure(self._pane(frame, results), f"frame {index}{time}")

    def make_scene(self, frame: TactileFrame, results: StageResults) -> scene_film.FrameScene:
        """Return both sensors and the object on a frame."""
        return scene_film.make_frame_scene(frame, results, self.translation, self.display)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of a scene or presentation, even, which most codecs need."""
        is_scene = self.asked.pane == SCENE
        usual = scene_film.DEFAULT_SIZE_PX if is_scene else PRESENTED_PX
        width, height = self.asked.size_px or usual
        return width // 2 * 2, height // 2 * 2

    def render_pane(self, index: int) -> sheet.RenderedPane:
        """Return the requested pane of a frame."""
        if self.asked.pane == SHEET:
            raise SettingProblem("a sheet is no cloud of points; name one pane of it with --pane")
        return self._pane(*self.evaluate_frame(index))

    def _pane(self, frame: TactileFrame, results: StageResults) -> sheet.RenderedPane:
        asked = self.asked
        return sheet.render_pane(
            asked.pane, frame, results, self.translation, self.display, asked.content
        )


def _picture(work: _Work) -> None:
    kind = work.asked.path.suffix.lower().removeprefix(".")
    drawn = work.draw_figure(work.translation.check_index(work.asked.frame))
    with open_atomic(work.asked.path, "the picture", None) as file:
        drawn.savefig(file, format=kind, metadata=dict(_UNDATED[kind]))


def _points(work: _Work) -> None:
    shown = work.render_pane(work.translation.check_index(work.asked.frame))
    if not len(shown.points_mm):
        raise SettingProblem(
            f"{work.asked.pane} of frame {work.asked.frame} has no point: nothing touches there; "
            "choose another frame"
        )
    head = (
        f"ply\nformat binary_little_endian 1.0\ncomment {shown.title}, mm, "
        f"{shown.preview.frame_name}\n"
        f"element vertex {len(shown.points_mm)}\nproperty float x\nproperty float y\nproperty "
        "float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
    )
    rows: Any = np.empty(len(shown.points_mm), dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3)])
    rows["xyz"] = shown.points_mm
    rows["rgb"] = shown.rgb
    with open_atomic(work.asked.path, "the points", None) as file:
        file.write(head.encode("ascii", "replace"))
        file.write(rows.tobytes())


def _arrays(work: _Work) -> None:
    frame, results = work.evaluate_frame(work.translation.check_index(work.asked.frame))
    pane = work.asked.pane
    wanted = {name: result for name, result in results.items() if pane in (SHEET, name)}
    write_arrays(work.asked.path, collect_stage_arrays(frame, wanted))


def _table(work: _Work) -> None:
    """Write force and all metrics against truth, one row per frame.

    Up to the requested stage, if it is one.
    """

    def make_row(index: int) -> tuple[int, float, Mapping[str, float]]:
        frame, results = work.evaluate_frame(index, every=work.asked.pane == SOURCE)
        metrics = work.translation.compute_metrics(results, index)
        return index, frame.time_s, metrics | measure_force(results, index, work.translation)

    rows = list(work.make_each(make_row))
    names = sorted({name for _, _, metrics in rows for name in metrics})
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    label = work.translation.truth_label
    table.writerow(["frame", "time_s", *names, *([label] if label else [])])
    for index, time_s, metrics in rows:
        values = (_number(metrics.get(name, np.nan)) for name in names)
        table.writerow([index, _number(time_s), *values, *(["yes"] if label else [])])
    with open_atomic(work.asked.path, "the table", None) as file:
        file.write(text.getvalue().encode())


def _section(work: _Work) -> None:
    """Write the heights of all panes along a line, as the window's tab copies them."""
    x0, y0, x1, y1 = work.asked.section
    line = cross_section.SectionLine(begin_mm=(x0, y0), end_mm=(x1, y1))
    translation = work.translation
    if not (np.isfinite(work.asked.section).all() and line.length_mm > 0):
        raise SettingProblem(
            f"a section needs a line that is longer than nothing, got {x0}, {y0} to {x1}, {y1} mm"
        )
    index = translation.check_index(work.asked.frame)
    frame, results = work.evaluate_frame(index, every=True)
    wanted = (
        (SOURCE, *translation.stages) if work.asked.pane == SHEET else work.asked.pane.split(",")
    )
    shown = [
        (
            name,
            sheet.render_pane(name, frame, results, translation, work.display).preview,
            None if name == SOURCE else results[name].output,
        )
        for name in wanted
    ]
    fields = cross_section.collect_height_maps(
        translation, translation.read_ground_truth(index), shown
    )
    if not fields:
        raise SettingProblem(
            f"{work.asked.pane} of frame {index} has no heights to be cut; name another pane"
        )
    with open_atomic(work.asked.path, "the section", None) as file:
        file.write(cross_section.format_csv(cross_section.cut_section(line, fields)).encode())


def _video(work: _Work) -> None:
    """Write the frames at the recording's own rate, or their presses in motion."""
    if work.asked.pane == SCENE:
        work.asked = replace(work.asked, frames=work.asked.frames or str(work.asked.frame))
        films = work.make_each(
            lambda index: work.make_scene(*work.evaluate_frame(index)).draw_film(work.size_px)
        )
        write_video(work.asked.path, chain.from_iterable(films), scene_film.FILM_RATE_HZ)
        return
    images = work.make_each(lambda index: _rgb(work.draw_figure(index)))
    write_video(work.asked.path, images, _rate_hz(work.translation, work.frame_indices))


def _rgb(drawn: Figure) -> Any:
    """Return (rows, cols, 3) uint8 with even sizes, which most codecs need."""
    canvas: Any = drawn.canvas
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())
    return pixels[: pixels.shape[0] // 2 * 2, : pixels.shape[1] // 2 * 2, :3]


def _rate_hz(translation: Translation, indices: Sequence[int]) -> float:
    times_s = translation.stream.times_s
    if times_s is None:
        return DEFAULT_VIDEO_RATE_HZ
    rate_hz = 1.0 / compute_interval_s(times_s[list(indices)])
    return float(np.clip(rate_hz, 1.0, 120.0)) if np.isfinite(rate_hz) else DEFAULT_VIDEO_RATE_HZ


def _number(value: float) -> str:
    return f"{value:.9g}" if np.isfinite(value) else ""


_WRITERS: Mapping[str, Callable[[_Work], None]] = {
    ".png": _picture,
    ".pdf": _picture,
    ".ply": _points,
    ".npz": _arrays,
    ".csv": _table,
    ".mp4": _video,
    ".avi": _video,
    ".webm": _video,
    ".webp": _video,
}
