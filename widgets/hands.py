"""How controls answer to wheel and keys: a wheel scrolls the panel, Enter gives the focus back."""

from __future__ import annotations

from PyQt6.QtCore import QEvent, QObject, Qt
from PyQt6.QtGui import QKeyEvent
from PyQt6.QtWidgets import QAbstractSlider, QAbstractSpinBox, QComboBox, QLineEdit, QScrollBar, QWidget

from widgets.looks import once

_ENTER = (Qt.Key.Key_Return, Qt.Key.Key_Enter)
_TYPED = (QAbstractSpinBox, QLineEdit)


class Hands(QObject):
    """Watches the controls of a window; give it those that come later too."""

    def __init__(self, window: QWidget) -> None:
        super().__init__(window)
        self._window = window
        self._soon = once(self, 0, self._back)
        self.take(window)

    def take(self, part: QWidget) -> None:
        """Watch every control in `part`."""
        for kind in (QAbstractSpinBox, QComboBox, QAbstractSlider, QLineEdit):
            for control in part.findChildren(kind):
                if isinstance(control, QScrollBar):
                    continue
                if control.focusPolicy() == Qt.FocusPolicy.WheelFocus:
                    control.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
                control.installEventFilter(self)

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """A wheel over a control that nobody works with goes on to what it stands in; Enter ends typing."""
        if a1 is None or not isinstance(a0, QWidget):
            return False
        if a1.type() == QEvent.Type.Wheel and not a0.hasFocus() and not isinstance(a0, QLineEdit):
            a1.ignore()
            return True
        typed = isinstance(a0, _TYPED) and a0.window() is self._window
        if typed and a1.type() == QEvent.Type.KeyPress and isinstance(a1, QKeyEvent) and a1.key() in _ENTER:
            self._soon.start()  # once the number is taken
        return False

    def _back(self) -> None:
        """Keys are the window's again."""
        focused = self._window.focusWidget()
        if focused is not None:
            focused.clearFocus()
        self._window.setFocus()
