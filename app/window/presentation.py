"""What one asks of any viewer: the whole screen, a picture on the clipboard, the values around a pixel."""

from __future__ import annotations

from PyQt6.QtCore import QObject
from PyQt6.QtGui import QGuiApplication
from PyQt6.QtWidgets import QWidget

from app.window.session_controller import SessionController
from widgets.magnifier import Magnifier


class PresentationController(QObject):
    """Between the commands and the window; a picture's values are looked up only while the magnifier is on."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller, self._window = controller, controller.window
        self._whole, self._large = (self._window.actions_by_name[name] for name in ("full_screen", "magnify"))
        self.magnifier = Magnifier(self._window)
        self._window.connect_command("full_screen", self._fill)
        self._window.connect_command("copy_image", self.copy_image)
        self._window.connect_command("magnify", self._magnify)
        for column in self._window.columns.values():
            column.pixel_hovered.connect(self._point)
        controller.probe.pixel_moved.connect(self._point)

    def copy_image(self) -> None:
        """The pane in front, or the window where several are, on the clipboard."""
        clipboard, shown = QGuiApplication.clipboard(), self._window.visible_columns()
        panes, what = self._window.panes, self._window
        only: QWidget = what
        if panes.isVisible():
            only = panes.panes[panes.active_pane]
        elif len(shown) == 1:
            only = self._window.columns[shown[0]]
        if clipboard is not None:
            clipboard.setPixmap(only.grab())
            size = only.size() * only.devicePixelRatioF()
            self._window.readout.setText(f"picture of {size.width()} x {size.height()} pixels copied")

    def _fill(self) -> None:
        self._window.showFullScreen() if self._whole.isChecked() else self._window.showNormal()

    def _magnify(self) -> None:
        if not self._large.isChecked():
            self.magnifier.hide()

    def _point(self, name: str, row: int, col: int) -> None:
        view = self._window.columns[name].view
        if not self._large.isChecked() or row < 0 or view.preview is None:
            self.magnifier.hide()
        else:
            self.magnifier.show_pixel(view.canvas, view.preview, row, col)
