"""Notifications over the page: they move nothing, and lie one above the other."""

from typing import Any

from PyQt6.QtCore import QEvent, QObject, QPoint
from PyQt6.QtWidgets import QWidget

from widgets.styling import make_single_shot_timer

_WIDTH_PX, _AROUND_PX, _BETWEEN_PX = 640, 10, 6


class NotificationStack(QWidget):
    """Covers no more than the notifications need, at the lower right of `page` within `over`; empty without any."""

    def __init__(self, over: QWidget, page: QWidget) -> None:
        super().__init__(over)
        self.setObjectName("notifications")
        self.setAccessibleName("notifications")
        self._page, self._bars = page, list[QWidget]()
        self._place_soon = make_single_shot_timer(self, 0, self.place)
        for widget in (over, page):
            widget.installEventFilter(self)
        self.hide()

    def add_bar(self, bar: QWidget) -> None:
        """Add a notification; it is placed whenever it is visible, later ones lower."""
        is_hidden = bar.isHidden()
        bar.setParent(self)
        bar.setAutoFillBackground(True)
        bar.setHidden(is_hidden)
        bar.installEventFilter(self)
        self._bars.append(bar)

    def place(self) -> None:
        """Place the visible notifications, and this widget around them."""
        shown = [bar for bar in self._bars if not bar.isHidden()]
        self.setVisible(bool(shown))
        over = self.parentWidget()
        if not shown or over is None:
            return
        corner = self._page.mapTo(over, QPoint(self._page.width(), self._page.height()))
        width_px = max(1, min(_WIDTH_PX, self._page.width() - 2 * _AROUND_PX))
        top_px = 0
        for bar in shown:
            height_px = bar.heightForWidth(width_px) if bar.hasHeightForWidth() else bar.sizeHint().height()
            bar.setGeometry(0, top_px, width_px, height_px)
            top_px += height_px + _BETWEEN_PX
        height_px = top_px - _BETWEEN_PX
        self.setGeometry(corner.x() - _AROUND_PX - width_px, corner.y() - _AROUND_PX - height_px, width_px, height_px)
        self.raise_()

    def eventFilter(self, a0: QObject | None, a1: Any) -> bool:  # noqa: N802
        """Place the notifications again when one changes, or what they lie on."""
        kind, kinds = None if a1 is None else a1.type(), QEvent.Type
        if kind == kinds.ShowToParent and a0 in self._bars:
            self.place()
        elif kind in (kinds.HideToParent, kinds.LayoutRequest, kinds.Resize, kinds.Move):
            self._place_soon.start()
        return super().eventFilter(a0, a1)
