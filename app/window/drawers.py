"""The drawers around the stages, and the rail of icons that opens and closes them; all are closed at first.

Pictures get the room. A drawer is a dock widget: it can be moved, stacked on another, or torn off the window.
"""

from __future__ import annotations

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtWidgets import QDockWidget, QMainWindow, QTabWidget, QToolBar, QWidget

from widgets.icons import make_command_icon

_AREA = Qt.DockWidgetArea
_SIDE_PX = {_AREA.LeftDockWidgetArea: 226, _AREA.RightDockWidgetArea: 290}
_LOW_PX, _MOST_LOW = 210, 0.25  # of the lower one; of the window: a small screen's pictures need the rest


class Drawers:
    """Frames at the left, parameters and alignment at the right; blame, log and timings below."""

    def __init__(
        self, window: QMainWindow, *, frames: QWidget, parameters: QWidget, alignment: QWidget, reading: QTabWidget
    ) -> None:
        self._window = window
        self.rail = QToolBar("Drawers", window)
        self.rail.setObjectName("rail")
        self.rail.setMovable(False)
        self.rail.setIconSize(QSize(20, 20))
        window.addToolBar(Qt.ToolBarArea.LeftToolBarArea, self.rail)
        self.frames = self._drawer("Frames", frames, _AREA.LeftDockWidgetArea, "table", "F2")
        self.parameters = self._drawer("Parameters", parameters, _AREA.RightDockWidgetArea, "sliders", "F3")
        self.alignment = self._drawer("Alignment", alignment, _AREA.RightDockWidgetArea, "axes", "F4")
        self.diagnostics = self._drawer("Blame, log and timings", reading, _AREA.BottomDockWidgetArea, "lines", "F5")
        window.tabifyDockWidget(self.parameters, self.alignment)
        window.setCorner(Qt.Corner.BottomLeftCorner, _AREA.LeftDockWidgetArea)
        window.setCorner(Qt.Corner.BottomRightCorner, _AREA.RightDockWidgetArea)
        for drawer in self.all_drawers:
            drawer.hide()

    @property
    def all_drawers(self) -> tuple[QDockWidget, ...]:
        """Every drawer, as the rail lists them."""
        return self.frames, self.parameters, self.alignment, self.diagnostics

    def _drawer(self, title: str, widget: QWidget, area: Qt.DockWidgetArea, icon: str, key: str) -> QDockWidget:
        drawer = QDockWidget(title, self._window)
        drawer.setObjectName(f"dock_{title.split(maxsplit=1)[0].strip(',').lower()}")
        drawer.setWidget(widget)
        self._window.addDockWidget(area, drawer)
        action = drawer.toggleViewAction()
        assert action is not None
        action.setIcon(make_command_icon(icon))
        action.setShortcut(key)
        action.setToolTip(f"{title} ({key})")
        action.triggered.connect(lambda: self._opened(drawer))
        self._window.addAction(action)
        self.rail.addAction(action)
        return drawer

    def _opened(self, drawer: QDockWidget) -> None:
        """In front of those it shares a place with, and no wider than it needs to be."""
        if drawer.isHidden():
            return
        drawer.raise_()
        area = self._window.dockWidgetArea(drawer)
        if area in _SIDE_PX:
            self._window.resizeDocks([drawer], [_SIDE_PX[area]], Qt.Orientation.Horizontal)
        else:
            high_px = min(_LOW_PX, round(_MOST_LOW * self._window.height()))
            self._window.resizeDocks([drawer], [high_px], Qt.Orientation.Vertical)
