"""`tactoscope calibrate force`: the scale of a sensor's force from weighed presses."""

import math
from pathlib import Path

from pipeline.calibration.force_scale import (
    ForceScale,
    fit_force_scale,
    format_force_scale,
    save_force_scale,
)
from pipeline.cli.terminal import open_progress_bar, print_line, print_table
from pipeline.cli.translation_options import (
    DEFAULT_OPTIONS,
    RecordingPath,
    StageSettings,
    TranslationOptions,
    find_sensor,
    split_list,
)
from pipeline.core.errors import SettingProblem
from pipeline.core.files import check_folder_for
from pipeline.core.frame_lists import parse_frames
from pipeline.translation.force import estimate_force
from pipeline.translation.translate import Translation, open_translation


def force(
    presses: RecordingPath,
    *,
    out: Path,
    forces: str = "",
    frames: str = "",
    options: TranslationOptions = DEFAULT_OPTIONS,
    settings: StageSettings = (),
) -> int:
    """Fit, save and report a force scale.

    Raises TouchError for presses or forces that cannot be used.

    Args:
        out: Calibration file to write (.npz); it also holds what the file of `--calibration` holds.
        forces: Weighed normal force of each press in N, such as `1.2,5.0`; default: the forces in
            the recording.
        frames: Frames of these presses, in the same order, such as `3,17`; default: all.
    """
    check_folder_for(out)
    path = out if out.suffix == ".npz" else out.with_name(out.name + ".npz")
    request = options.build_request(presses, find_sensor(presses, options))
    with open_translation(request, settings=settings) as translation:
        listed = [
            index
            for part in split_list(frames)
            for index in parse_frames(part, translation.n_frames)
        ]
        indices = listed or parse_frames("", translation.n_frames)
        weighed_n = _parse_forces(forces, indices, translation)
        if "depth" not in translation.stages:
            raise SettingProblem(
                f"the route {translation.route.name!r} measures no depth; choose --route t2d2"
            )
        estimated_n: list[float] = []
        with open_progress_bar() as progress:
            for done, index in enumerate(indices):
                progress.step(done / len(indices), f"frame {index}")
                frame = translation.stream.frame(index)
                depth = translation.evaluate(frame, ["depth"], progress)["depth"].output
                estimated_n.append(estimate_force(depth, frame, translation).normal_n)
        scale = fit_force_scale(translation.source.name, estimated_n, weighed_n)
    save_force_scale(scale, path, request.calibration)
    _print_report(scale, indices)
    print_line(f"calibration written to {path}; use it with --calibration")
    return 0


def _parse_forces(forces: str, indices: list[int], translation: Translation) -> list[float]:
    """The weighed force of every frame, N; those of the recording where `forces` is empty."""
    if not forces.strip():
        truths = [translation.read_source_truth(index) for index in indices]
        known = [-float(t.force_n[2]) for t in truths if t is not None and t.force_n is not None]
        if len(known) < len(indices):
            raise SettingProblem(
                "the recording holds no forces; give the weighed ones with --forces, such as "
                "1.2,5.0"
            )
        return known
    try:
        values = [float(word) for word in split_list(forces)]
    except ValueError:
        raise SettingProblem(
            f"--forces takes numbers in N such as 1.2,5.0, got {forces[:40]!r}"
        ) from None
    if len(values) != len(indices) or not all(map(math.isfinite, values)):
        raise SettingProblem(
            f"--forces has {len(values)} values for {len(indices)} frames; give one for each, or "
            "name the frames with "
            "--frames"
        )
    return values


def _print_report(scale: ForceScale, indices: list[int]) -> None:
    print_table(
        ("frame", "estimated (N)", "weighed (N)", "scaled (N)"),
        (
            (str(index), *(f"{n:.3f}" for n in (estimated, weighed, scale.apply(float(estimated)))))
            for index, (estimated, weighed) in zip(indices, scale.weighings_n, strict=True)
        ),
    )
    for line in format_force_scale(scale):
        print_line(line)
