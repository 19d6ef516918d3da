"""Keyboard and wheel of controls: the wheel scrolls the panel, Enter returns the focus, Tab enters controls."""

from PyQt6.QtCore import QEvent, QObject, Qt
from PyQt6.QtGui import QFocusEvent, QKeyEvent
from PyQt6.QtWidgets import (
    QAbstractButton,
    QAbstractItemView,
    QAbstractSlider,
    QAbstractSpinBox,
    QComboBox,
    QLineEdit,
    QScrollBar,
    QTabBar,
    QWidget,
)

from widgets.styling import make_single_shot_timer

_ENTER = (Qt.Key.Key_Return, Qt.Key.Key_Enter)
_TYPED = (QAbstractSpinBox, QLineEdit)
_Key, _Why = Qt.Key, Qt.FocusReason
_ALONG = frozenset((_Key.Key_Left, _Key.Key_Right, _Key.Key_Home, _Key.Key_End))
_OWN = {  # keys that are commands of the window as well
    QAbstractButton: frozenset((_Key.Key_Space, *_ENTER)),
    QComboBox: frozenset((_Key.Key_Space, _Key.Key_Home, _Key.Key_End)),
    QAbstractSlider: _ALONG,
    QTabBar: _ALONG,
    QAbstractItemView: frozenset((_Key.Key_Home, _Key.Key_End, _Key.Key_Space, *_ENTER)),
}
_BY_KEYS = frozenset((_Why.TabFocusReason, _Why.BacktabFocusReason, _Why.ShortcutFocusReason))


class KeyboardFocusFilter(QObject):
    """Filters the events of a window's controls; register controls that are added later."""

    def __init__(self, window: QWidget) -> None:
        super().__init__(window)
        self._window = window
        self._soon = make_single_shot_timer(self, 0, self._back)
        self._held: QWidget | None = None  # focused by key: a click leaves the window its shortcuts
        self.watch_controls(window)

    def watch_controls(self, part: QWidget) -> None:
        """Watch every control in `part`."""
        for kind in (QAbstractSpinBox, QLineEdit, *_OWN):
            for control in part.findChildren(kind):
                if isinstance(control, QScrollBar):
                    continue
                if control.focusPolicy() == Qt.FocusPolicy.WheelFocus:
                    control.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
                control.installEventFilter(self)

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """Pass the wheel of an unfocused control to its parent; let Enter end typing."""
        if a1 is None or not isinstance(a0, QWidget):
            return False
        if isinstance(a1, QFocusEvent):
            self._held = a0 if a1.gotFocus() and a1.reason() in _BY_KEYS else None
        elif isinstance(a1, QKeyEvent) and a0 is self._held and _knows(a0, a1.key()):
            if a1.type() == QEvent.Type.ShortcutOverride:
                a1.accept()
                return True
            if a1.type() == QEvent.Type.KeyPress and isinstance(a0, QAbstractButton) and a1.key() in _ENTER:
                a0.click()
                return True
        if a1.type() == QEvent.Type.Wheel and not a0.hasFocus() and not isinstance(a0, QLineEdit):
            a1.ignore()
            return True
        typed = isinstance(a0, _TYPED) and a0.window() is self._window
        if typed and a1.type() == QEvent.Type.KeyPress and isinstance(a1, QKeyEvent) and a1.key() in _ENTER:
            self._soon.start()  # after the spin box has taken the number
        return False

    def _back(self) -> None:
        """Return the focus to the window."""
        focused = self._window.focusWidget()
        if focused is not None:
            focused.clearFocus()
        self._window.setFocus()


def _knows(control: QWidget, key: int) -> bool:
    """Return whether a control uses a key itself."""
    return any(isinstance(control, kind) and key in keys for kind, keys in _OWN.items())
