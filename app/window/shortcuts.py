"""Hands that stay on the keyboard: pictures pointed at by arrow keys, and the alignment typed."""

from __future__ import annotations

from functools import partial

from PyQt6.QtCore import QEvent, QObject, Qt

from app.window.session_controller import SessionController
from widgets.preview_key_filter import PreviewKeyFilter

_HOW = (
    "arrow keys move the pixel, or the section line (with Ctrl its end A, with Alt B), Shift ten times as far; "
    "Enter pins; + and \N{MINUS SIGN} zoom; , and . move the wipe; Tab goes to the next picture; P ends"
)


class KeyboardController(QObject):
    """Gives pictures the keyboard and takes it back."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._window, self._tracer = controller.window, controller.probe
        self._opened = lambda: controller.views.translation is not None
        for name, column in self._window.columns.items():
            keys = PreviewKeyFilter(column.view)
            keys.pixel_pointed.connect(partial(self._tracer.move_to_pixel, name))
            keys.pixel_pinned.connect(partial(self._tracer.toggle_pin, name))
            keys.focus_passed.connect(partial(self._pass, name))
        self._window.connect_command("probe_by_keys", self._change)
        self._window.connect_command("cancel", self._end)
        self._window.connect_command("edit_alignment", self._type_alignment)
        self._box, self._waits = self._window.alignment.rows["x"].box, False
        self._box.installEventFilter(self)

    @property
    def focused_column(self) -> str:
        """The column whose picture has the keyboard; "" where none has."""
        return next((name for name, column in self._window.columns.items() if column.view.canvas.hasFocus()), "")

    @property
    def _shown(self) -> list[str]:
        return [name for name, column in self._window.columns.items() if column.isVisible() and column.view.preview]

    def _change(self) -> None:
        if self.focused_column:
            self._end()
            return
        panes, shown = self._window.panes, self._shown
        wanted = panes.active_stage if panes.isVisible() else ""
        if shown:
            self._give(wanted if wanted in shown else shown[0])

    def _give(self, name: str) -> None:
        self._window.columns[name].view.canvas.setFocus(Qt.FocusReason.OtherFocusReason)
        self._window.readout.setText(_HOW)
        self._window.readout.setToolTip(_HOW)

    def _pass(self, name: str, by: int) -> None:
        shown = self._shown
        if name in shown:
            self._give(shown[(shown.index(name) + by) % len(shown)])

    def _end(self) -> None:
        if self.focused_column:
            self._window.setFocus()
            self._window.readout.setText("")

    def _type_alignment(self) -> None:
        drawer = self._window.drawers.alignment
        drawer.show()
        drawer.raise_()
        self._waits = self._opened()  # for the numbers to be there
        self._enter_box()

    def _enter_box(self) -> None:
        if self._waits and self._box.isEnabled() and self._box.isVisible():
            self._waits = False
            self._box.setFocus(Qt.FocusReason.ShortcutFocusReason)
            self._box.selectAll()

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """The alignment takes numbers only once it knows what was felt."""
        if a1 is not None and a1.type() == QEvent.Type.EnabledChange:
            self._enter_box()
        return super().eventFilter(a0, a1)
