"""Keys of a preview: its pixel, overlay and zoom.

Keys and wheel of controls: Tab enters them, Enter leaves them.
"""

import numpy as np
from PyQt6.QtCore import QEvent, QObject, QPointF, Qt, pyqtSignal
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

from widgets.style.styling import make_single_shot_timer
from widgets.views.preview_view import PreviewView

Key = Qt.Key
ARROW_STEPS = {
    Key.Key_Left: (-1, 0),
    Key.Key_Right: (1, 0),
    Key.Key_Up: (0, -1),
    Key.Key_Down: (0, 1),
}
SHIFT_STEP_PX = 10  # step with Shift
_END_KEYS = (Key.Key_Return, Key.Key_Enter)
_TABS = {Key.Key_Tab: 1, Key.Key_Backtab: -1}
_ZOOMS = {Key.Key_Plus: 1.25, Key.Key_Equal: 1.25, Key.Key_Minus: 0.8}
_HANDLE = {Key.Key_Comma: -0.05, Key.Key_Period: 0.05}  # steps as shares of the image width
_KNOWN = frozenset((*ARROW_STEPS, *_END_KEYS, *_TABS, *_ZOOMS, *_HANDLE))
_TYPED = (QAbstractSpinBox, QLineEdit)
_Why = Qt.FocusReason
_ENDS = (Key.Key_Home, Key.Key_End)
_ALONG = (Key.Key_Left, Key.Key_Right, *_ENDS)
_OWN = {  # keys that are commands of the window as well
    QAbstractButton: (Key.Key_Space, *_END_KEYS),
    QComboBox: (Key.Key_Space, *_ENDS),
    QAbstractSlider: _ALONG,
    QTabBar: _ALONG,
    QAbstractItemView: (*_ENDS, Key.Key_Space, *_END_KEYS),
}
_BY_KEYS = frozenset((_Why.TabFocusReason, _Why.BacktabFocusReason, _Why.ShortcutFocusReason))


def get_arrow_step_px(event: QKeyEvent) -> tuple[int, int]:
    """Return the step right and down of an arrow key in pixels; (0, 0) for other keys."""
    x, y = ARROW_STEPS.get(Key(event.key()), (0, 0))
    far = SHIFT_STEP_PX if event.modifiers() & Qt.KeyboardModifier.ShiftModifier else 1
    return far * x, far * y


class PreviewKeyFilter(QObject):
    """Handles the keys of a focused preview before they become shortcuts of the window.

    A preview does not take the focus by itself: a click leaves the window its shortcuts, and Tab
    skips it.
    """

    pixel_pointed = pyqtSignal(int, int)  # row, col
    pixel_pinned = pyqtSignal(int, int)
    focus_passed = pyqtSignal(int)  # focus to the next or previous preview

    def __init__(self, view: PreviewView) -> None:
        super().__init__(view)
        self._view = view
        self._canvas = view.canvas
        self._canvas.installEventFilter(self)

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """Handle keys before the window's shortcuts."""
        if not isinstance(a1, QKeyEvent) or a1.key() not in _KNOWN:
            return super().eventFilter(a0, a1)
        if a1.type() == QEvent.Type.ShortcutOverride:
            a1.accept()
            return True
        return a1.type() == QEvent.Type.KeyPress and self._press(a1)

    def _press(self, event: QKeyEvent) -> bool:
        key = Key(event.key())
        picture = self._view.preview
        if key in _TABS:
            self.focus_passed.emit(_TABS[key])
        elif picture is None:
            return False
        elif key in _ZOOMS:
            self._canvas.set_view(self._middle(), self._canvas.scale * _ZOOMS[key])
            self._canvas.view_changed.emit()
        elif key in _HANDLE:
            if self._canvas.handle_share is not None:
                self._view.overlay.move_handle(self._view.overlay.share + _HANDLE[key])
        else:
            rows, cols = picture.pixels.shape[:2]
            at = self._middle()
            right, down = get_arrow_step_px(event)
            if self._canvas.crosshair is None:  # the first key shows the cursor only
                right = down = 0
            row = int(at.y()) + down
            col = int(at.x()) + right
            text = self.pixel_pinned if key in _END_KEYS else self.pixel_pointed
            text.emit(min(max(row, 0), rows - 1), min(max(col, 0), cols - 1))
        return True

    def _middle(self) -> QPointF:
        """Return the cursor pixel, else the highest value in contact, else the centre."""
        if self._canvas.crosshair is not None:
            return QPointF(self._canvas.crosshair[1] + 0.5, self._canvas.crosshair[0] + 0.5)
        box = self._view.find_contact_box_px()
        picture = self._view.preview
        if box is None or picture is None:
            return self._canvas.centre
        left, top, right, below = (max(0, round(side)) for side in box)
        part = None if picture.values is None else picture.values[top:below, left:right]
        if part is None or not np.isfinite(part).any():
            return QPointF(0.5 * (left + right), 0.5 * (top + below))
        row, col = divmod(int(np.nanargmax(part)), part.shape[1])
        return QPointF(left + col + 0.5, top + row + 0.5)


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
        kind = a1.type()
        if isinstance(a1, QFocusEvent):
            self._held = a0 if a1.gotFocus() and a1.reason() in _BY_KEYS else None
        elif isinstance(a1, QKeyEvent):
            is_held = a0 is self._held and _knows(a0, a1.key())
            is_end = kind == QEvent.Type.KeyPress and a1.key() in _END_KEYS
            if is_held and kind == QEvent.Type.ShortcutOverride:
                a1.accept()
                return True
            if is_held and is_end and isinstance(a0, QAbstractButton):
                a0.click()
                return True
            if is_end and isinstance(a0, _TYPED) and a0.window() is self._window:
                self._soon.start()  # after the spin box has taken the number
        elif kind == QEvent.Type.Wheel and not (a0.hasFocus() or isinstance(a0, QLineEdit)):
            a1.ignore()
            return True
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
