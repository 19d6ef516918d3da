"""Full screen, image to clipboard, and the magnifier."""

from __future__ import annotations

from PyQt6.QtCore import QObject
from PyQt6.QtGui import QGuiApplication
from PyQt6.QtWidgets import QWidget

from app.window.session_controller import SessionController
from widgets.magnifier import Magnifier


class PresentationController(QObject):
    """Connects the commands with the window."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller, self._window = controller, controller.window
        self._full_screen, self._magnify = (self._window.actions_by_name[name] for name in ("full_screen", "magnify"))
        self.magnifier = Magnifier(self._window)
        self._window.connect_command("full_screen", self._set_full_screen)
        self._window.connect_command("copy_image", self.copy_image)
        self._window.connect_command("magnify", self._hide_magnifier)
        for column in self._window.columns.values():
            column.pixel_hovered.connect(self._show_pixel)
        controller.probe.pixel_moved.connect(self._show_pixel)

    def copy_image(self) -> None:
        """Copy an image of the only or active pane, else of the window."""
        clipboard, shown = QGuiApplication.clipboard(), self._window.visible_columns()
        panes = self._window.panes
        widget: QWidget = self._window
        if panes.isVisible():
            widget = panes.panes[panes.active_pane]
        elif len(shown) == 1:
            widget = self._window.columns[shown[0]]
        if clipboard is not None:
            clipboard.setPixmap(widget.grab())
            size = widget.size() * widget.devicePixelRatioF()
            self._window.readout.setText(f"image of {size.width()} x {size.height()} pixels copied")

    def _set_full_screen(self) -> None:
        self._window.showFullScreen() if self._full_screen.isChecked() else self._window.showNormal()

    def _hide_magnifier(self) -> None:
        if not self._magnify.isChecked():
            self.magnifier.hide()

    def _show_pixel(self, name: str, row: int, col: int) -> None:
        view = self._window.columns[name].view
        if not self._magnify.isChecked() or row < 0 or view.preview is None:
            self.magnifier.hide()
        else:
            self.magnifier.show_pixel(view.canvas, view.preview, row, col)
