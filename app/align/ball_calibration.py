"""Calibration of the source sensor from the open recording, where its frames are presses of one
ball.
"""

from functools import partial
from pathlib import Path

from PyQt6.QtWidgets import QInputDialog

from app.document.session_controller import SessionController
from app.export.export import ExportController
from app.window.jobs import JobReporter
from pipeline.core.errors import SettingProblem, escape_text
from pipeline.translation.translate import Translation

_DIAMETER_MM = 6.35  # of a quarter-inch bearing ball
_MIN_MM = 0.1
_MAX_MM = 1000.0
_QUESTION = (
    "Diameter in mm of the ball that every frame of this recording shows,\npressed at "
    "another place of the gel each"
)


def ask_calibration(controller: SessionController, export: ExportController) -> None:
    """Ask for the ball's diameter and the file to write, then calibrate."""
    diameter_mm, accepted = QInputDialog.getDouble(
        controller.window, "Calibrate here", _QUESTION, _DIAMETER_MM, _MIN_MM, _MAX_MM, 3
    )
    if accepted and (path := export.ask_save_path("save_calibration")):
        calibrate(controller, export, diameter_mm, path)


def calibrate(
    controller: SessionController, export: ExportController, diameter_mm: float, path: Path
) -> None:
    """Fit and write the table of the open recording; it becomes the session's calibration."""
    opened = controller.views.translation
    if opened is None:
        return

    def use_table(quality: str) -> str:
        controller.change("calibrate", calibration=path)
        return f"calibration written to {escape_text(path.name)}: {quality}"

    work = partial(calibrate_recording, opened, diameter_mm, path)
    export.start_writing("calibrating", work, path, describe=use_table)


def calibrate_recording(
    opened: Translation, diameter_mm: float, path: Path, report: JobReporter
) -> str:
    """Write the calibration of the source from all frames with a reference.

    Returns one sentence on its quality.

    Raises TouchError for frames that are no presses of a ball, or a sensor that is not a gel.
    """
    from pipeline.calibration.calibration_file import save
    from pipeline.calibration.quality_notes import describe_quality
    from pipeline.stages.depth.ball_calibration import calibrate_sensor

    frames = [opened.stream.frame(i) for i in range(opened.n_frames)]
    reference = frames[0].reference
    if opened.source.optics is None or reference is None:
        raise SettingProblem(
            "a calibration by a ball needs frames of a gel and a reference image; the source is "
            f"{opened.source.title}"
        )
    images = [frame.image.astype("uint8", copy=False) for frame in frames]
    table = calibrate_sensor(
        images, reference.astype("uint8", copy=False), opened.source, diameter_mm, progress=report
    )
    save(table, path)
    return describe_quality(table)
