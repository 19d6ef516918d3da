"""A recorded rollout as a video: the scene, its touches and the force, one image per tick.

The scene is drawn without a 3D library, by a depth buffer in numpy.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.arrays import Image, freeze
from pipeline.core.errors import TouchError
from pipeline.core.figures import make_figure
from pipeline.core.files import check_folder_for, require_separate
from pipeline.core.progress import SILENT, Progress
from pipeline.lab.tasks.rollout_file import read_rollout
from pipeline.lab.tasks.scene_view import (
    ESTIMATE_COLOUR,
    ESTIMATE_NAME,
    OBJECT_COLOUR,
    TRUE_NAME,
    build_scene,
    compute_bounds,
    describe_tick,
    make_scene_layers,
    make_traces,
)
from pipeline.lab.tasks.task import RecordedRollout, describe_error, load_task
from pipeline.lab.tasks.touches import NONE, OWN, TRUE, make_touch_request
from pipeline.translation.reports.export_request import PaneContent
from pipeline.translation.reports.sheet import render_pane
from pipeline.translation.reports.video import write_video
from pipeline.translation.translate import open_translation
from pipeline.views.colours import Rgb
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import Preview
from pipeline.views.scene_drawing import draw_scene, make_view

_INCHES = (11.2, 6.4)
_DPI = 100
_SCENE_PX = (600, 560)  # width and height
# left, bottom, width, height as shares
_SCENE_AXES = (0.01, 0.015, 600 / 1120, 560 / 640)
_FORCE_AXES = (0.62, 0.1, 0.35, 0.28)
_TOUCH_TITLES = ("source", "generated touch", "true touch")
_MAX_RATE_HZ = 60.0


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
    scene = build_scene(rollout)
    layers = make_scene_layers(scene)
    camera, camera_from_world = make_view(compute_bounds(scene), *_SCENE_PX)
    shown = -1
    draw: Callable[[Image, int], Image] | None = None
    for tick in range(rollout.n_ticks):
        progress.step(tick / rollout.n_ticks, f"tick {tick}")
        decision = rollout.find_decision(tick)
        if draw is None or decision != shown:
            draw = _lay_out(rollout, decision)
            shown = decision
        poses = {name: camera_from_world @ pose for name, pose in scene.place(tick).items()}
        yield draw(draw_scene(layers, camera, poses), tick)


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

            def show(pane: str, shown: PaneContent = "computed") -> Preview:
                return render_pane(pane, frame, results, translation, display, shown).preview

            return (
                show("source"),
                None if touch in (TRUE, NONE, OWN) else show("touch"),
                show("touch", "truth") if "touch" in truths else None,
            )
    except TouchError:
        return None, None, None


def _lay_out(rollout: RecordedRollout, decision: int) -> Callable[[Image, int], Image]:
    """Lay out what stays the same during one decision.

    Returns what draws the image of a tick, from the scene's image.
    """
    from matplotlib.lines import Line2D

    figure: Any = make_figure(figsize=_INCHES, dpi=_DPI)
    run = rollout.summary
    title = (
        f"{run.case}, trial {run.trial}, touch {run.touch}, {run.tolerance_mm:g} mm: "
        f"{run.cause.partition(';')[0]}"
    )
    colour = "black" if run.succeeds else "#8c2d04"
    figure.text(0.01, 0.955, title, fontsize=12, weight="bold", color=colour)
    if run.decisions and not run.succeeds:
        error_title = load_task(rollout.plan.task).error_title
        error = describe_error(run.decisions[decision], error_title, succeeds=False)
        figure.text(0.01, 0.915, error, fontsize=9)
    for k, (name, preview) in enumerate(
        zip(_TOUCH_TITLES, read_touches(rollout, decision), strict=True)
    ):
        axes = figure.add_axes((0.555 + 0.148 * k, 0.52, 0.14, 0.36))
        axes.set_axis_off()
        axes.set_title(name if preview is not None else f"{name}: none", fontsize=9)
        if preview is not None:
            axes.imshow(preview.pixels)
    axes = figure.add_axes(_FORCE_AXES)
    axes.plot(rollout.time_s, make_traces(rollout)[0].values, color="black", linewidth=1.2)
    axes.set(xlabel="time, s", ylabel="contact force, N")
    for one in run.decisions:
        axes.axvline(rollout.time_s[one.tick], color="#d55e00", linewidth=0.8, linestyle=":")
    cursor = axes.axvline(0.0, color=_to_hex(ESTIMATE_COLOUR))
    handles = [
        Line2D([], [], color=_to_hex(OBJECT_COLOUR), linewidth=4, label=TRUE_NAME),
        Line2D([], [], color=_to_hex(ESTIMATE_COLOUR), linestyle="--", label=ESTIMATE_NAME),
    ]
    place = {"loc": "lower left", "bbox_to_anchor": (0.3, 0.9), "ncols": 2}
    figure.legend(handles=handles, fontsize=8, frameon=False, **place)
    axes = figure.add_axes(_SCENE_AXES)
    axes.set_axis_off()
    width, height = _SCENE_PX
    scene = axes.imshow(np.zeros((height, width, 3), np.uint8))
    caption = axes.text(8, height - 12, "", color="#282828")

    def draw(image: Image, tick: int) -> Image:
        scene.set_data(image)
        caption.set_text(describe_tick(rollout, tick))
        cursor.set_xdata([rollout.time_s[tick]] * 2)
        figure.canvas.draw()
        return freeze(np.asarray(figure.canvas.buffer_rgba())[..., :3].copy())

    return draw


def _to_hex(colour: Rgb) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)
