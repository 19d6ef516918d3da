"""Calibration of the source sensor from the open recording, where its frames are presses of one ball."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtWidgets import QInputDialog

from app.window import dialogs
from app.window.autosave import AutosaveController
from app.window.background_controller import BackgroundController
from app.window.session_controller import SessionController
from app.work.jobs import JobReporter
from pipeline.base.errors import SettingProblem
from pipeline.base.text import escape_text
from pipeline.translation.translate import Translation
from widgets.notification_bar import NotificationBar

_DIAMETER_MM = 6.35  # of a quarter-inch bearing ball
_MIN_MM, _MAX_MM = 0.1, 1000.0
_QUESTION = (
    "Diameter in mm of the ball that every frame of this recording shows,\npressed at another place of the gel each"
)


class BallCalibrationController(BackgroundController):
    """Asks for the ball and a file, fits the table in the background, and uses it."""

    def __init__(self, controller: SessionController, autosave: AutosaveController) -> None:
        super().__init__("calibration", controller)
        self._autosave, self._window = autosave, controller.window
        self.notification = NotificationBar("calibration_notification")
        self._window.notifications.add_bar(self.notification)
        self._path = Path()

    def ask(self) -> None:
        """Ask for the ball's diameter and the file to write, then calibrate."""
        diameter_mm, accepted = QInputDialog.getDouble(
            self._window, "Calibrate here", _QUESTION, _DIAMETER_MM, _MIN_MM, _MAX_MM, 3
        )
        path = (
            dialogs.ask_save_path(self._window, "save_calibration", self._autosave.dialog_folder) if accepted else None
        )
        if path is not None:
            self.calibrate(diameter_mm, path)

    def calibrate(self, diameter_mm: float, path: Path) -> None:
        """Fit and write the table of the open recording; it becomes the session's calibration."""
        opened = self._controller.views.translation
        if opened is not None:
            self._path = path
            self.notification.show_notification("calibrating…", (("Cancel", self.cancel),), stays=True)
            self.start(lambda report: calibrate_recording(opened, diameter_mm, path, report))

    def show_progress(self, fraction: float, text: str) -> None:  # noqa: ARG002 - the bar has its own text
        """Show the progress in the notification."""
        self.notification.show_progress(fraction)

    def show_result(self, result: object) -> None:
        """Use the table, and say how good it is."""
        self.notification.show_notification(f"calibration written to {escape_text(self._path.name)}: {result}")
        self._controller.change("calibrate", calibration=self._path)

    def show_failure(self, error: BaseException) -> None:
        """Show why there is no calibration."""
        self.notification.hide()
        super().show_failure(error)

    def show_cancelled(self) -> None:
        """Show that no file was written."""
        self.notification.show_notification("cancelled; nothing was written")


def calibrate_recording(opened: Translation, diameter_mm: float, path: Path, report: JobReporter) -> str:
    """Write the calibration of the source from all frames with a reference; returns one sentence on its quality.

    Raises TouchError for frames that are no presses of a ball, or a sensor that is not a gel.
    """
    from pipeline.calibration.calibration_file import save
    from pipeline.calibration.quality_notes import describe_quality
    from pipeline.stages.depth.ball_calibration import calibrate_sensor

    frames = [opened.stream.frame(i) for i in range(opened.n_frames)]
    reference = frames[0].reference
    if opened.source.optics is None or reference is None:
        raise SettingProblem(
            f"a calibration by a ball needs frames of a gel and a reference image; the source is {opened.source.title}"
        )
    images = [frame.image.astype("uint8", copy=False) for frame in frames]
    table = calibrate_sensor(images, reference.astype("uint8", copy=False), opened.source, diameter_mm, progress=report)
    save(table, path)
    return describe_quality(table)
