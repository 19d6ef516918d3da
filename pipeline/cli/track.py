"""`tactoscope track`: the motion of a touched object and a map of its surface, without its mesh."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from pipeline.cli.terminal import open_progress_bar, print_error, print_line, print_table
from pipeline.cli.translation_options import (
    DEFAULT_OPTIONS,
    RecordingPath,
    StageSettings,
    TranslationOptions,
    find_sensor,
)
from pipeline.core.files import check_folder
from pipeline.core.frame_lists import parse_frames
from pipeline.lab.tracking.track_record import TABLE, TrackRecord, write_record
from pipeline.lab.tracking.track_recording import track_recording
from pipeline.translation.translate import open_translation

TrackedStage = Annotated[
    Literal["depth", "touch_depth"],
    Parameter(
        help="Membrane to follow: the source's, or that of the generated touch (needs `--target`)."
    ),
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
    """Write track.csv, track.json and the fused surface patch.ply.

    Report drift where true poses are known.

    Returns 0, or 2 if some frame could not be read and so counts as lost.

    Args:
        out: Folder for the results.
        target: Sensor whose generated touches are followed with `--stage touch_depth`.
        frames: Frames such as `0-40` or `3,7`; default: all.
    """
    source = target or find_sensor(recording, options)
    check_folder(out)
    with open_translation(
        options.build_request(recording, source), settings=settings
    ) as translation:
        indices = parse_frames(frames, translation.n_frames)
        with open_progress_bar() as progress:
            record = track_recording(translation, stage, indices, progress)
    write_record(out, record)
    for problem in record.problems:
        print_error(problem)
    _print_summary(record, out)
    return 2 if record.problems else 0


def _print_summary(record: TrackRecord, out: Path) -> None:
    counts = {
        "frames": len(record.rows),
        **{state: record.count(state) for state in ("tracked", "lost", "no contact")},
        "parts": record.n_parts,
        "key frames": len(record.key_frames),
        "closed loops": record.n_loops,
    }
    print_table(counts, [map(str, counts.values())])
    if record.weak_directions:
        print_line(
            "not measured in some frames, and taken as in the frame before: "
            f"{'; '.join(record.weak_directions[:3])}"
        )
    if record.error is not None:
        print_line(
            f"largest error {record.error.drift_mm:.3f} mm and {record.error.drift_deg:.2f} "
            "degrees over a path of "
            f"{record.error.path_mm:.1f} mm and {record.error.turned_deg:.0f} degrees"
        )
    patch = (
        "no surface could be fused"
        if record.patch is None
        else f"{len(record.patch.triangles)} triangles"
    )
    print_line(f"{out / TABLE}, patch map: {patch}")
