"""`tactoscope inspect`: checks of a recording, or the expected error of a calibration."""

from pathlib import Path

from pipeline.calibration import calibration_file, force_scale, quality_notes
from pipeline.cli.terminal import open_progress_bar, print_line
from pipeline.cli.translation_options import DepthUnit, ReferenceFrames, ReferenceImagePath
from pipeline.io.inspection.recording_report import format_report_lines, inspect_recording
from pipeline.io.reference_estimate import write_reference


def inspect(
    recording: Path,
    *,
    sensor: str = "",
    stream: str = "",
    reference: ReferenceImagePath = None,
    reference_frames: ReferenceFrames = "",
    depth_unit: DepthUnit = "auto",
    make_reference: Path | None = None,
) -> int:
    """Print the report of a recording or a calibration file; returns 1 if a check fails.

    Args:
        recording: File or folder of any known format, or a calibration file.
        sensor: Sensor that made the recording, if the file does not name it.
        stream: Name of the stream to report on; default: all.
        make_reference: Image file to write first: the median of the recording's images, in which
            touches at different places vanish. The report then uses it as the reference.
    """
    if make_reference is not None:
        with open_progress_bar() as progress:
            _, n_images = write_reference(recording, make_reference, progress)
        print_line(
            f"{make_reference} is the median of {n_images} images; check that it shows no touch"
        )
        reference = make_reference
    if calibration_file.is_calibration_file(recording):
        table = calibration_file.load_if_present(recording)
        scale = force_scale.load_force_scale(recording)
        for line in [] if table is None else quality_notes.format_calibration(table):
            print_line(line)
        for line in [] if scale is None else force_scale.format_force_scale(scale):
            print_line(line)
        return 0
    report = inspect_recording(
        recording,
        sensor=sensor,
        stream=stream,
        reference=reference,
        reference_frames=reference_frames,
        depth_unit=depth_unit,
    )
    for line in format_report_lines(report):
        print_line(line)
    return 0 if report.has_passed else 1
