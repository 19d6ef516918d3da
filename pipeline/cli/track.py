"""`tactoscope track`: the motion of a touched object and a map of its surface, without its mesh."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from pipeline.base.arrays import Doubles
from pipeline.base.files import prepare_folder, write_json, write_text
from pipeline.base.frame_lists import parse_frames
from pipeline.base.progress import Progress
from pipeline.cli.interrupts import interruptible_progress
from pipeline.cli.terminal import print_line
from pipeline.cli.translation_options import DEFAULT_OPTIONS, RecordingPath, StageSettings, TranslationOptions
from pipeline.recordings import open_recording
from pipeline.sensors.spec import load_sensor
from pipeline.tracking.patch_map import write_patch
from pipeline.tracking.track import Track, TrackError, compute_error, format_csv, track_frames
from pipeline.translation.catalogue import with_settings
from pipeline.translation.translate import Translation, open_translation
from pipeline.values.results import DepthMap

TrackedStage = Annotated[
    Literal["depth", "touch_depth"],
    Parameter(help="Membrane to follow: the source's, or that of the generated touch (needs `--target`)."),
]


def track(
    recording: RecordingPath,
    *,
    out: Path,
    target: str = "",
    stage: TrackedStage = "depth",
    frames: str = "",
    options: TranslationOptions = DEFAULT_OPTIONS,
    settings: StageSettings = (),
) -> int:
    """Write track.csv, track.json and the fused surface patch.ply; report drift where true poses are known.

    Parameters
    ----------
    out
        Folder for the results.
    target
        Sensor whose generated touches are followed with `--stage touch_depth`.
    frames
        Frames such as `0-40` or `3,7`; default: all.
    """
    source = target or _find_sensor(recording, options)
    prepare_folder(out)
    with closing(open_translation(options.build_request(recording, source))) as translation:
        indices = parse_frames(frames, translation.n_frames)
        with Console(stderr=True).status("") as status, interruptible_progress() as progress:
            status.update(f"{len(indices)} frames")
            result = track_frames(indices, _depth_reader(translation, stage, settings, progress), progress)
        error = compute_error(result, lambda index: _read_pose(translation, stage, index))
    write_text(out / "track.csv", format_csv(result), "the track")
    write_json(out / "track.json", {
        "stage": stage, "frames": len(result.frames), "lost": result.n_lost, "parts": result.n_parts,
        "key_frames": [key.index for key in result.keys], "closed_loops": result.n_loops,
        "error": None if error is None else asdict(error),
    })  # fmt: skip
    if result.patch is not None:
        write_patch(out / "patch.ply", result.patch)
    _print_summary(result, error, out)
    return 0


def _find_sensor(recording: Path, options: TranslationOptions) -> str:
    """The sensor that made the recording: its own target where only its depth is followed."""
    if options.sensor:
        return options.sensor
    with closing(open_recording(recording, depth_unit=options.depth_unit, reference=options.reference)) as opened:
        stream = opened.stream(options.stream)
        return stream.sensor or load_sensor(options.sensor).name


def _depth_reader(
    translation: Translation, stage: str, settings: StageSettings, progress: Progress
) -> Callable[[int], DepthMap]:
    """A function that computes the membrane of one frame."""
    graph, params = translation.build_graph(), with_settings(translation.methods, settings)

    def read_depth(index: int) -> DepthMap:
        inputs = translation.read_inputs(index, progress=progress)
        return graph.evaluate([stage], inputs, params)[stage].output

    return read_depth


def _read_pose(translation: Translation, stage: str, index: int) -> Doubles | None:
    """The true pose `sensor_from_object` (4, 4) in the frame of the followed sensor; None where unknown."""
    truth = translation.read_source_truth(index)
    if stage == "touch_depth":
        other = translation.read_target_observation(index)
        truth = None if other is None else other[1]
    return None if truth is None else truth.sensor_from_object


def _print_summary(result: Track, error: TrackError | None, out: Path) -> None:
    table = Table("frames", "tracked", "lost", "no contact", "parts", "key frames", "closed loops")
    states = [frame.state for frame in result.frames]
    counts = (len(states), *(states.count(state) for state in ("tracked", "lost", "no contact")))
    table.add_row(*(str(n) for n in (*counts, result.n_parts, len(result.keys), result.n_loops)))
    Console().print(table)
    weak = sorted({direction for frame in result.frames for direction in frame.weak_directions})
    if weak:
        print_line(f"not measured in some frames, and taken as in the frame before: {'; '.join(weak[:3])}")
    if error is not None:
        print_line(
            f"largest error {error.drift_mm:.3f} mm and {error.drift_deg:.2f} degrees over a path of "
            f"{error.path_mm:.1f} mm and {error.turned_deg:.0f} degrees"
        )
    patch = "no surface could be fused" if result.patch is None else f"{len(result.patch.triangles)} triangles"
    print_line(f"{out / 'track.csv'}, patch map: {patch}")
