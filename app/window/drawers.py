"""The drawers around the stages, and the icon rail that opens and closes them.

A drawer is a dock widget: it can be moved, stacked or undocked. All are closed at first, to leave the images room.
"""

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtWidgets import QDockWidget, QMainWindow, QTabWidget, QToolBar, QWidget

from widgets.command_bar import name_extension
from widgets.icons import make_command_icon

_AREA = Qt.DockWidgetArea
_SIDE_PX = {_AREA.LeftDockWidgetArea: 360, _AREA.RightDockWidgetArea: 290}
_MAX_SIDE_SHARE = 0.2  # of the window's width, for the frames table
_BOTTOM_PX, _MAX_BOTTOM_SHARE = 210, 0.25  # height of the bottom drawer, and its largest share of the window


class Drawers:
    """Frames at the left, parameters and alignment at the right, diagnostics at the bottom."""

    def __init__(
        self, window: QMainWindow, *, frames: QWidget, parameters: QWidget, alignment: QWidget, diagnostics: QTabWidget
    ) -> None:
        self._window = window
        self.rail = QToolBar("Drawers", window)
        self.rail.setObjectName("rail")
        self.rail.setMovable(False)
        name_extension(self.rail)
        self.rail.setIconSize(QSize(20, 20))
        window.addToolBar(Qt.ToolBarArea.LeftToolBarArea, self.rail)
        self.frames = self._add_drawer("Frames", frames, _AREA.LeftDockWidgetArea, "table", "F2")
        self.parameters = self._add_drawer("Parameters", parameters, _AREA.RightDockWidgetArea, "sliders", "F3")
        self.alignment = self._add_drawer("Alignment", alignment, _AREA.RightDockWidgetArea, "axes", "F4")
        self.diagnostics = self._add_drawer("Diagnostics", diagnostics, _AREA.BottomDockWidgetArea, "lines", "F5")
        window.tabifyDockWidget(self.parameters, self.alignment)
        window.setCorner(Qt.Corner.BottomLeftCorner, _AREA.LeftDockWidgetArea)
        window.setCorner(Qt.Corner.BottomRightCorner, _AREA.RightDockWidgetArea)
        for drawer in self.all_drawers:
            drawer.hide()

    @property
    def all_drawers(self) -> tuple[QDockWidget, ...]:
        """Every drawer, in the order of the rail."""
        return self.frames, self.parameters, self.alignment, self.diagnostics

    def _add_drawer(self, title: str, widget: QWidget, area: Qt.DockWidgetArea, icon: str, key: str) -> QDockWidget:
        drawer = QDockWidget(title, self._window)
        drawer.setObjectName(f"dock_{title.lower()}")
        drawer.setWidget(widget)
        self._window.addDockWidget(area, drawer)
        action = drawer.toggleViewAction()
        assert action is not None
        action.setIcon(make_command_icon(icon))
        action.setShortcut(key)
        action.setToolTip(f"{title} ({key})")
        action.triggered.connect(lambda: self._fit_drawer(drawer))
        self._window.addAction(action)
        self.rail.addAction(action)
        button = self.rail.widgetForAction(action)
        if button is not None:
            button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
            button.setAccessibleName(title)
        return drawer

    def _fit_drawer(self, drawer: QDockWidget) -> None:
        """Raise an opened drawer, and give it its default width or height."""
        if drawer.isHidden():
            return
        drawer.raise_()
        area = self._window.dockWidgetArea(drawer)
        if area in _SIDE_PX:
            most_px = round(_MAX_SIDE_SHARE * self._window.width())
            width_px = min(_SIDE_PX[area], max(most_px, _SIDE_PX[_AREA.RightDockWidgetArea]))
            self._window.resizeDocks([drawer], [width_px], Qt.Orientation.Horizontal)
        else:
            height_px = min(_BOTTOM_PX, round(_MAX_BOTTOM_SHARE * self._window.height()))
            self._window.resizeDocks([drawer], [height_px], Qt.Orientation.Vertical)
