"""`tactoscope calibrate balls`: presses of a ball become a look-up, with its residuals said."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import cast

from rich.console import Console
from rich.table import Table

from pipeline.base.arrays import Image
from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.base.files import prepare_folder_for
from pipeline.calibration.calibration_file import save
from pipeline.calibration.calibration_table import Calibration
from pipeline.calibration.quality_notes import format_calibration
from pipeline.cli.terminal import ProgressBar, create_progress_bar, print_line
from pipeline.recordings import open_recording
from pipeline.sensors.spec import SensorSpec
from pipeline.sensors.spec import load_sensor as sensor_named
from pipeline.stages.depth.ball_calibration import calibrate_sensor
from pipeline.stages.depth.photometric import describe_mismatch
from pipeline.values.frames import TactileFrame

_LOOKED_AT = 5  # presses: one in ten does not tell a mirrored picture
MAX_BALL_DIAMETER_MM = 1000.0  # flat, as far as any gel can tell


@dataclass(frozen=True, slots=True, kw_only=True)
class BallCalibrationRequest:
    """What is asked for."""

    presses: Path
    sensor: str
    diameter_mm: float
    reference: Path
    out: Path
    pixel_mm: float | None
    pattern: str
    seed: int


def run_ball_calibration(asked: BallCalibrationRequest) -> int:
    """Fit, save and report; raises TouchError for what is wrong with the presses."""
    _check(asked)
    pixel_mm = asked.pixel_mm
    spec = sensor_named(asked.sensor)
    frames = _pictures(asked.presses, spec, asked.reference, asked.pattern)
    for told in dict.fromkeys(describe_mismatch(frame, spec) for frame in frames[:_LOOKED_AT]):
        if told:
            print_line(f"doubtful: {told}; this look-up will suit pictures of that kind and no others")
    images, untouched = [cast("Image", f.image) for f in frames], cast("Image", frames[0].reference)
    with create_progress_bar() as bar:
        fitted = calibrate_sensor(
            images, untouched, spec, asked.diameter_mm, pixel_mm=pixel_mm, progress=ProgressBar(bar), seed=asked.seed
        )
    save(fitted, asked.out)
    _report(fitted)
    if pixel_mm is None:
        print_line(
            f"presses of one ball fit any width of a pixel alike: {fitted.pixel_mm:.4f} mm is that of the description "
            f"of {spec.name}; if it is not this unit's, measure it and give --pixel-mm: all sizes and depths go with it"
        )
    print_line(f"look-up written to {asked.out}; use it with --calibration")
    return 0


def _check(asked: BallCalibrationRequest) -> None:
    """Raise for what is wrong before anything is read."""
    diameter_mm, pixel_mm = asked.diameter_mm, asked.pixel_mm
    if not 0.1 <= diameter_mm <= MAX_BALL_DIAMETER_MM:
        raise SettingProblem(f"--diameter-mm must lie within 0.1 and {MAX_BALL_DIAMETER_MM:g} mm, got {diameter_mm:g}")
    if pixel_mm is not None and not 1e-4 <= pixel_mm <= 10.0:
        raise SettingProblem(f"--pixel-mm must lie within 0.0001 and 10 mm, got {pixel_mm:g}")
    if asked.seed < 0:
        raise SettingProblem(f"--seed must be 0 or more, got {asked.seed}")
    if not asked.pattern:
        raise SettingProblem("--pattern is empty; '*' takes every picture")
    prepare_folder_for(asked.out)


def _pictures(folder: Path, spec: SensorSpec, reference: Path, pattern: str) -> list[TactileFrame]:
    """The presses, all with one untouched picture."""
    recording = open_recording(folder, sensor=spec.name, reference=reference)
    stream = recording.stream()
    frames = [stream.frame(i) for i in range(stream.n_frames)]
    frames = [f for f in frames if Path(f.origin).match(pattern)]
    if not frames:
        raise FileProblem(f"no picture matches {pattern!r}", folder)
    untouched = frames[0].reference
    if untouched is None or untouched.ndim != 3:
        raise FileProblem("the reference must be a colour picture of the untouched sensor", reference)
    return frames


def _report(fitted: Calibration) -> None:
    table = Table("press", "centre (px)", "contact radius (px)", "slope residual (mm/mm)")
    for p in fitted.presses:
        residual = f"{p.residual:.3f}" if p.used else "not used"
        table.add_row(str(p.index), f"{p.x_px:.1f}, {p.y_px:.1f}", f"{p.radius_px:.1f}", residual)
    Console().print(table)
    for line in format_calibration(fitted):
        print_line(line)
