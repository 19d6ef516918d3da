"""`tactoscope calibrate balls`: a calibration table from presses of a ball, with its residuals."""

from collections.abc import Sequence
from pathlib import Path
from typing import cast

from pipeline.calibration.calibration_file import save
from pipeline.calibration.calibration_table import Calibration
from pipeline.calibration.quality_notes import format_calibration
from pipeline.cli.terminal import open_progress_bar, print_line, print_table
from pipeline.core.arrays import Image
from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.files import check_folder_for
from pipeline.core.params import check_range
from pipeline.core.values.frames import TactileFrame
from pipeline.io import open_recording
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.ball_calibration import calibrate_sensor
from pipeline.stages.depth.photometric import describe_mismatch

_CHECKED_FRAMES = 5  # presses checked for a mirrored image: one in ten does not show it
MAX_BALL_DIAMETER_MM = 200.0  # nearly flat, for any gel


def balls(
    presses: Path,
    *,
    sensor: str,
    diameter_mm: float,
    reference: Path,
    out: Path,
    pixel_mm: float | None = None,
    pattern: str = "*",
    stream: str = "",
) -> int:
    """Fit, save and report a calibration table.

    Raises TouchError for presses or options that cannot be used.

    Args:
        presses: Folder of images, one press each, anywhere on the gel.
        sensor: Sensor that made them.
        diameter_mm: Diameter of the ball.
        reference: Reference image (no contact) of the sensor.
        out: Calibration file to write (.npz).
        pixel_mm: Width of a pixel on the gel; default: the sensor description's.
        pattern: File names of the folder to use, such as `ball_6.310mm_*`.
        stream: Name of the stream, if the presses are a recording with several.
    """
    check_range("--diameter-mm", diameter_mm, 0.1, MAX_BALL_DIAMETER_MM, "mm")
    if pixel_mm is not None:
        check_range("--pixel-mm", pixel_mm, 1e-4, 10.0, "mm")
    if not pattern:
        raise SettingProblem("--pattern is empty; '*' takes every image")
    check_folder_for(out)
    spec = load_sensor(sensor)
    frames = _load_presses(presses, sensor, reference, pattern, stream)
    for mismatch in dict.fromkeys(
        describe_mismatch(frame, spec) for frame in frames[:_CHECKED_FRAMES]
    ):
        if mismatch:
            print_line(f"warning: {mismatch}; this calibration will fit images of that kind only")
    images = [cast("Image", f.image) for f in frames]
    reference_image = cast("Image", frames[0].reference)
    with open_progress_bar() as progress:
        table = calibrate_sensor(
            images,
            reference_image,
            spec,
            diameter_mm,
            pixel_mm=pixel_mm,
            progress=progress,
        )
    path = save(table, out)
    _print_report(table, [Path(frame.origin).name for frame in frames])
    if pixel_mm is None:
        print_line(
            f"presses of one ball do not determine the pixel width: {table.pixel_mm:.4f} mm is "
            "that of the description "
            f"of {spec.name}; measure yours and give --pixel-mm if it differs: all sizes and "
            "depths scale with it"
        )
    print_line(f"calibration written to {path}; use it with --calibration")
    return 0


def _load_presses(
    folder: Path, sensor: str, reference: Path, pattern: str, stream: str
) -> list[TactileFrame]:
    """The press images that match `pattern`, all with the same reference image."""
    presses = open_recording(folder, sensor=sensor, stream=stream, reference=reference).stream(
        stream
    )
    frames = [presses.frame(i) for i in range(presses.n_frames)]
    frames = [frame for frame in frames if Path(frame.origin).match(pattern)]
    if not frames:
        raise FileProblem(f"no image matches {pattern!r}", folder)
    # a copy would judge itself
    distinct = {cast("Image", frame.image).tobytes(): frame for frame in reversed(frames)}
    if len(distinct) < len(frames):
        print_line(
            f"warning: {len(frames) - len(distinct)} images are copies of others and left out"
        )
        frames = list(reversed(distinct.values()))
    image = frames[0].reference
    if image is None or image.ndim != 3:
        raise FileProblem(
            "the reference must be a colour image of the sensor without contact", reference
        )
    return frames


def _print_report(calibration: Calibration, names: Sequence[str]) -> None:
    print_table(
        ("press", "centre (px)", "contact radius (px)", "slope residual (mm/mm)"),
        (
            (
                names[p.index],
                f"{p.x_px:.1f}, {p.y_px:.1f}",
                f"{p.radius_px:.1f}",
                f"{p.residual:.3f}",
            )
            if p.used
            else (names[p.index], "-", "-", "not used")
            for p in calibration.presses
        ),
    )
    for line in format_calibration(calibration):
        print_line(line)
