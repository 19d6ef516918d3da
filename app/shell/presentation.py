"""Full screen presentation, image to clipboard, and the magnifier."""

from dataclasses import replace

from PyQt6.QtGui import QGuiApplication

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.session.layout import Layout
from app.views.stage_previews import StagePreview
from pipeline.translation.pixel_trace import SOURCE
from pipeline.translation.reports.presentation import name_pane, name_sensors
from widgets.views.magnifier import Magnifier


class PresentationController(Feature):
    """Connects the commands with the window."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._full_screen, self._magnify = (
            self._actions[name] for name in ("full_screen", "magnify")
        )
        self.magnifier = Magnifier(self._window)
        self._window.connect_command("full_screen", self._set_full_screen)
        self._window.connect_command("copy_image", self.copy_image)
        self._window.connect_command("magnify", self._hide_magnifier)
        self._layout_before: Layout | None = None  # while something is presented
        self._window.connect_command("cancel", self.leave)
        for column in self._columns.values():
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
        """Show the panes of *Look* alone on the full screen, the press in motion.

        Esc or F11 leaves.
        """
        controller = self._controller
        if controller.views.translation is None:
            self._window.say("nothing to present; open a recording first")
            self._full_screen.setChecked(False)
            return
        self._full_screen.setChecked(True)
        self._layout_before = controller.session.layout
        if self._layout_before.name != "look":
            controller.change("present", layout=replace(self._layout_before, name="look"))
        self._window.set_presenting(on=True)
        self.show_frame()
        self._actions["press_motion"].setChecked(True)

    def close(self) -> None:
        """Leave the full screen."""
        self.leave()

    def leave(self) -> None:
        """Show the window as it was, on the frame shown last."""
        self._full_screen.setChecked(False)
        layout = self._layout_before
        if not self._window.is_presenting or layout is None:
            return
        self._layout_before = None
        self._window.set_presenting(on=False)
        if not self._controller.is_closed:
            self._change("present", layout=layout)

    def show_frame(self) -> None:
        """Name sensor and method of every pane."""
        opened = self._translation
        if not self._window.is_presenting or opened is None:
            return
        titles = dict[tuple[str, bool], str]()
        for stage in (SOURCE, *opened.stages):
            part = self._views.get_shown_stage(stage)
            result = part.result if isinstance(part, StagePreview) else None
            titles[stage, False] = name_pane(opened, stage, result)
            titles[stage, True] = name_sensors(opened)
        self._window.look.show_titles(titles)

    def _set_full_screen(self) -> None:
        self.present() if self._full_screen.isChecked() else self.leave()

    def _hide_magnifier(self) -> None:
        if not self._magnify.isChecked():
            self.magnifier.hide()

    def _show_pixel(self, name: str, row: int, col: int) -> None:
        view = self._columns[name].view
        if not self._magnify.isChecked() or row < 0 or view.preview is None:
            self.magnifier.hide()
        else:
            self.magnifier.show_pixel(view.canvas, view.preview, row, col)
