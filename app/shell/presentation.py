"""Full screen presentation and its video, image to clipboard, and the magnifier."""

from pathlib import Path

from PyQt6.QtCore import QSize
from PyQt6.QtGui import QGuiApplication

from app.document.evaluator import Evaluator
from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.export.export import ExportController
from app.shell.presentation_jobs import choose_presented_stages, make_panes, write_presentation
from app.window.jobs import JobReporter
from pipeline.core.errors import escape_text
from pipeline.translation.reports.video import find_h264_encoder
from pipeline.views.contrast import FittedContrast
from widgets.shell.presentation_view import PresentationView
from widgets.views.magnifier import Magnifier

# commands whose shortcuts act in the presentation too
_COMMANDS = (
    "full_screen",
    "play",
    "first",
    "previous",
    "next",
    "last",
    "back_10",
    "forward_10",
    "loop",
)


class PresentationController(Feature):
    """Connects the commands with the window."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._full_screen, self._magnify = (
            self._window.actions_by_name[name] for name in ("full_screen", "magnify")
        )
        self.magnifier = Magnifier(self._window)
        self._window.connect_command("full_screen", self._set_full_screen)
        self._window.connect_command("copy_image", self.copy_image)
        self._window.connect_command("magnify", self._hide_magnifier)
        self.view: PresentationView | None = None  # while something is presented
        self._contrast = FittedContrast()
        controller.frame_shown.connect(self._show_frame)
        controller.closing.connect(self.leave)
        for column in self._window.columns.values():
            column.pixel_hovered.connect(self._show_pixel)
        controller.probe.pixel_moved.connect(self._show_pixel)

    def copy_image(self) -> None:
        """Copy an image of the active pane, else of the window."""
        clipboard = QGuiApplication.clipboard()
        look = self._window.look
        widget = look.panes[look.active_pane] if look.isVisible() else self._window
        if clipboard is not None:
            clipboard.setPixmap(widget.grab())
            size = widget.size() * widget.devicePixelRatioF()
            self._window.say(f"image of {size.width()} x {size.height()} pixels copied")

    def present(self) -> None:
        """Show source, generated touch and truth on the full screen of the window.

        Esc or F11 leaves.
        """
        opened = self._controller.views.translation
        screen = self._window.screen()
        if opened is None:
            self._window.say("nothing to present; open a recording first")
            self._full_screen.setChecked(False)
            return
        self._full_screen.setChecked(True)
        self._contrast = FittedContrast()
        self.view = PresentationView()
        self.view.left.connect(self.leave)
        self.view.addActions([self._window.actions_by_name[name] for name in _COMMANDS])
        if screen is not None:
            self.view.setGeometry(screen.geometry())
        self._window.presented_columns = choose_presented_stages(opened)
        self.view.showFullScreen()
        self._controller.refresh()

    def leave(self) -> None:
        """Close the presentation; the window is as it was, on the frame shown last."""
        view = self.view
        self.view = None
        self._full_screen.setChecked(False)
        if view is not None:
            self._window.presented_columns = ()
            view.close()
            view.deleteLater()
            self._controller.refresh()

    def _show_frame(self, _index: int) -> None:
        """Show the frame once all of it is there: the one before stays as it is until then."""
        opened = self._controller.views.translation
        views = self._controller.views
        if self.view is None or opened is None:
            return
        shown = {name: views.get_shown_stage(name) for name in self._window.presented_columns}
        panes = make_panes(opened, shown, self._contrast)
        if panes:
            self.view.show_panes(panes)

    def _set_full_screen(self) -> None:
        self.present() if self._full_screen.isChecked() else self.leave()

    def _hide_magnifier(self) -> None:
        if not self._magnify.isChecked():
            self.magnifier.hide()

    def _show_pixel(self, name: str, row: int, col: int) -> None:
        view = self._window.columns[name].view
        if not self._magnify.isChecked() or row < 0 or view.preview is None:
            self.magnifier.hide()
        else:
            self.magnifier.show_pixel(view.canvas, view.preview, row, col)


_SIZE = QSize(1920, 1080)
_NO_H264 = "; H.264 needs an ffmpeg with libx264 on the PATH"


class PresentationVideoController(Feature):
    """Asks for a file, then writes all frames as the presentation shows them."""

    def __init__(self, controller: SessionController, export: ExportController) -> None:
        super().__init__(controller)
        self._export = export
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
            return (
                f"written as {codec}: "
                f"{escape_text(str(path))}{_NO_H264 if codec == 'MJPEG' else ''}"
            )

        self._export.start_writing(
            f"writing {escape_text(path.name)}", work, path, describe=describe
        )
