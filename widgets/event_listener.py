"""Functions called at events of widgets."""

from collections.abc import Callable

from PyQt6.QtCore import QEvent, QObject
from PyQt6.QtWidgets import QWidget


class EventListener(QObject):
    """Calls `then` at events of these kinds of a widget, before the widget handles them; lives as long as it."""

    def __init__(self, widget: QWidget, then: Callable[[], object], *kinds: QEvent.Type) -> None:
        super().__init__(widget)
        self._then, self._kinds = then, kinds
        widget.installEventFilter(self)

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """Call the function."""
        del a0
        if a1 is not None and a1.type() in self._kinds:
            self._then()
        return False
