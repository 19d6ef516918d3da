"""The command that writes the presentation as a video, in the background."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtCore import QObject, QSize

from app.window.export import ExportController
from app.window.session_controller import SessionController
from app.work.evaluator import Evaluator
from app.work.jobs import JobReporter
from app.work.presentation_video import write_presentation
from pipeline.base.text import escape_text
from pipeline.reporting.video import find_h264_encoder

_SIZE = QSize(1920, 1080)
_NO_H264 = "; H.264 needs an ffmpeg with libx264 on the PATH"


class PresentationVideoController(QObject):
    """Asks for a file, then writes all frames as the presentation shows them."""

    def __init__(self, controller: SessionController, export: ExportController) -> None:
        super().__init__(controller)
        self._controller, self._export = controller, export
        controller.window.connect_command("save_video", self.ask)

    def ask(self) -> None:
        """Ask where the video goes, then write it."""
        path = self._export.ask_path("Save video", ".mp4" if find_h264_encoder() else ".avi")
        if path is not None:
            self.write(path)

    def write(self, path: Path, size: QSize = _SIZE) -> None:
        """Write the video of the open recording."""
        controller = self._controller
        session = controller.session

        def work(report: JobReporter) -> str:
            evaluator = Evaluator(controller.catalogue, like=controller.evaluator)
            try:
                return write_presentation(session, evaluator, size, path, report)
            finally:
                evaluator.close()

        def describe(codec: object) -> str:
            return f"written as {codec}: {escape_text(str(path))}{_NO_H264 if codec == 'MJPEG' else ''}"

        self._export.start_writing(f"writing {escape_text(path.name)}", work, path, describe=describe)
