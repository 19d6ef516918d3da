"""A recorded rollout as a video: the scene, its touches and the force, one image per tick."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.core.arrays import Image, freeze
from pipeline.core.errors import TouchError
from pipeline.core.figures import make_figure
from pipeline.core.files import check_folder_for, require_separate
from pipeline.core.progress import SILENT, Progress
from pipeline.lab.tasks.rerun import describe_error
from pipeline.lab.tasks.rollout_file import read_rollout
from pipeline.lab.tasks.scene_image import SceneDrawing, make_view
from pipeline.lab.tasks.scene_view import (
    ESTIMATE_COLOUR,
    ESTIMATE_NAME,
    OBJECT_COLOUR,
    TRUE_NAME,
    build_scene,
    compute_bounds,
    make_plain_scene,
    make_scene_layers,
)
from pipeline.lab.tasks.task import RecordedRollout, load_task
from pipeline.lab.tasks.touches import NONE, OWN, TRUE, make_touch_request
from pipeline.lab.tasks.traces import describe_tick, make_traces
from pipeline.translation.reports.sheet import render_pane
from pipeline.translation.reports.video import write_video
from pipeline.translation.translate import open_translation
from pipeline.views.colours import Rgb
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import Preview

_SIZE_PX = (1120, 640)
_DPI = 100
_SCENE_PX = (10, 70, 600, 560)  # left, top, width, height of the scene
_FORCE_AXES = (0.62, 0.1, 0.35, 0.28)  # left, bottom, width, height as shares
_TOUCH_TITLES = ("source", "generated touch", "true touch")
_MAX_RATE_HZ = 60.0


class _Background(NamedTuple):
    """What stays the same during one decision, and where the cursor of the force goes."""

    pixels: Image
    cursor_x_px: tuple[int, ...]  # of every tick
    cursor_rows: tuple[int, int]


def write_rollout_video(path: Path, out: Path, progress: Progress = SILENT) -> None:
    """Write a recorded rollout as .mp4 or .avi, one image per tick at the rate of the ticks.

    Raises TouchError.
    """
    require_separate(out, [path])
    check_folder_for(out)
    rollout = read_rollout(path)
    steps_s = np.diff(rollout.time_s)
    rate_hz = (
        1.0 / float(np.median(steps_s)) if len(steps_s) and np.median(steps_s) > 0 else _MAX_RATE_HZ
    )
    write_video(out, draw_ticks(rollout, progress), float(np.clip(rate_hz, 1.0, _MAX_RATE_HZ)))


def draw_ticks(rollout: RecordedRollout, progress: Progress = SILENT) -> Iterator[Image]:
    """One image (rows, cols, 3) per tick."""
    try:
        scene = build_scene(rollout)
    except TouchError:
        scene = make_plain_scene(rollout)
    left, top, width, height = _SCENE_PX
    drawing = SceneDrawing(
        make_scene_layers(scene), *make_view(compute_bounds(scene), width, height)
    )
    shown = -1
    background = None
    for tick in range(rollout.n_ticks):
        progress.step(tick / rollout.n_ticks, f"tick {tick}")
        decision = rollout.find_decision(tick)
        if background is None or decision != shown:
            background = _draw_background(rollout, decision)
            shown = decision
        image = background.pixels.copy()
        image[top : top + height, left : left + width] = drawing.draw(scene.place(tick))
        _draw_cursor(image, background, tick)
        _write_text(image, describe_tick(rollout, tick), (left + 8, top + height - 12))
        yield freeze(image)


def read_touches(rollout: RecordedRollout, decision: int) -> tuple[Preview | None, ...]:
    """Source, generated and true touch of a decision's frame; None where there is none."""
    try:
        task = load_task(rollout.plan.task)
        touch = rollout.summary.touch
        request = make_touch_request(touch, rollout.path, task.source, task.target)
        with open_translation(request) as translation:
            index = min(decision, translation.n_frames - 1)
            frame = translation.stream.frame(index)
            results = translation.evaluate(index, ["touch"])
            display = DisplayParams()
            truths = translation.read_true_outputs(index)
            source = render_pane("source", frame, results, translation, display).preview
            made = render_pane("touch", frame, results, translation, display).preview
            true = (
                render_pane("touch", frame, results, translation, display, "truth")
                if "touch" in truths
                else None
            )
    except TouchError:
        return None, None, None
    return (
        source,
        None if touch in (TRUE, NONE, OWN) else made,
        None if true is None else true.preview,
    )


def _draw_background(rollout: RecordedRollout, decision: int) -> _Background:
    from matplotlib.lines import Line2D

    width, height = _SIZE_PX
    figure: Any = make_figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    run = rollout.summary
    title = (
        f"{run.case}, trial {run.trial}, touch {run.touch}, {run.tolerance_mm:g} mm: "
        f"{run.cause.partition(';')[0]}"
    )
    figure.text(
        0.01, 0.955, title, fontsize=12, weight="bold", color="black" if run.succeeds else "#8c2d04"
    )
    if run.decisions and not run.succeeds:
        error = describe_error(
            run.decisions[decision], load_task(rollout.plan.task).error_title, succeeds=False
        )
        figure.text(0.01, 0.915, error, fontsize=9)
    for k, (name, preview) in enumerate(
        zip(_TOUCH_TITLES, read_touches(rollout, decision), strict=True)
    ):
        axes = figure.add_axes((0.555 + 0.148 * k, 0.52, 0.14, 0.36))
        axes.set_axis_off()
        axes.set_title(name if preview is not None else f"{name}: none", fontsize=9)
        if preview is not None:
            axes.imshow(preview.pixels)
    force = make_traces(rollout)[0]
    axes = figure.add_axes(_FORCE_AXES)
    axes.plot(rollout.time_s, force.values, color="black", linewidth=1.2)
    axes.set_xlabel("time, s", fontsize=9)
    axes.set_ylabel("contact force, N", fontsize=9)
    axes.tick_params(labelsize=8)
    for one in run.decisions:
        axes.axvline(rollout.time_s[one.tick], color="#d55e00", linewidth=0.8, linestyle=":")
    handles = [
        Line2D([], [], color=_to_hex(OBJECT_COLOUR), linewidth=4, label=TRUE_NAME),
        Line2D([], [], color=_to_hex(ESTIMATE_COLOUR), linestyle="--", label=ESTIMATE_NAME),
    ]
    figure.legend(
        handles=handles,
        loc="lower left",
        bbox_to_anchor=(0.3, 0.9),
        ncols=2,
        fontsize=8,
        frameon=False,
    )
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[:height, :width, :3].copy()
    x = axes.transData.transform(np.column_stack([rollout.time_s, np.zeros(rollout.n_ticks)]))[:, 0]
    box = axes.get_window_extent()
    return _Background(
        pixels=freeze(pixels),
        cursor_x_px=tuple(round(value) for value in x.tolist()),
        cursor_rows=(round(height - box.y1), round(height - box.y0)),
    )


def _to_hex(colour: Rgb) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


def _draw_cursor(image: Image, background: _Background, tick: int) -> None:
    first, last = background.cursor_rows
    x = background.cursor_x_px[tick]
    image[first:last, x - 1 : x + 1] = ESTIMATE_COLOUR


def _write_text(image: Image, text: str, place_px: tuple[int, int]) -> None:
    import cv2

    cv2.putText(image, text, place_px, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (40, 40, 40), 1, cv2.LINE_AA)
