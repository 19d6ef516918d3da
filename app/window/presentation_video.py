"""The command that writes the presentation as a video, in the background."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtCore import QSize

from app.window import dialogs
from app.window.autosave import AutosaveController
from app.window.background_controller import BackgroundController
from app.window.session_controller import SessionController
from app.work.evaluator import Evaluator
from app.work.jobs import JobReporter
from app.work.presentation_video import find_h264_encoder, write_presentation
from pipeline.base.text import escape_text
from widgets.notification_bar import NotificationBar

_SIZE = QSize(1920, 1080)
_NO_H264 = "; H.264 needs an ffmpeg with libx264 on the PATH"


class PresentationVideoController(BackgroundController):
    """Asks for a file, then writes all frames as the presentation shows them."""

    def __init__(self, controller: SessionController, autosave: AutosaveController) -> None:
        super().__init__("presentation video", controller)
        self._autosave, self._window = autosave, controller.window
        self.notification = NotificationBar("video_notification")
        self._window.notifications.add_bar(self.notification)
        self._window.connect_command("save_video", self.ask)

    def ask(self) -> None:
        """Ask where the video goes, then write it."""
        if self._controller.views.translation is None:
            self.notification.show_notification("no recording to present; open one first")
            return
        suffix = ".mp4" if find_h264_encoder() else ".avi"
        path = dialogs.ask_export_path(self._window, "Save video", suffix, self._autosave.dialog_folder)
        if path is not None:
            self._autosave.preferences.last_folder = path.parent
            self.write(path)

    def write(self, path: Path, size: QSize = _SIZE) -> None:
        """Write the video of the open recording."""
        session, like = self._controller.session, self._controller.evaluator
        self.notification.show_notification(
            f"writing {escape_text(path.name)}…", (("Cancel", self.cancel),), stays=True
        )

        def work(report: JobReporter) -> tuple[Path, str]:
            evaluator = Evaluator(self._controller.catalogue, like=like)
            try:
                return path, write_presentation(session, evaluator, size, path, report)
            finally:
                evaluator.close()

        self.start(work)

    def show_progress(self, fraction: float, text: str) -> None:  # noqa: ARG002 - the bar has its own text
        """Show the progress in the notification."""
        self.notification.show_progress(fraction)

    def show_result(self, result: object) -> None:
        """Name file and codec."""
        assert isinstance(result, tuple)
        path, codec = result
        self.notification.show_notification(f"written as {codec}: {path}{_NO_H264 if codec == 'MJPEG' else ''}")

    def show_failure(self, error: BaseException) -> None:
        """Show the error in the banner."""
        self.notification.hide()
        super().show_failure(error)

    def show_cancelled(self) -> None:
        """Show that no file was written."""
        self.notification.show_notification("cancelled; nothing was written")
