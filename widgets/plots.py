"""Plots in the theme's colours, with pan, zoom and export; pyqtgraph is imported when the first one is shown."""

from typing import Any

from PyQt6.QtCore import QEvent, QSize
from PyQt6.QtGui import QPalette
from PyQt6.QtWidgets import QVBoxLayout, QWidget

from widgets.base import EventListener
from widgets.styling import fill, set_spacing
from widgets.theme import ThemeColours, get_theme_colours


class Plot(QWidget):
    """Axes with labels; subclasses override `draw`, and call `redraw` when their data change."""

    preferred_px = 320, 320  # width, height

    def __init__(self, name: str, description: str, across: str = "", up: str = "") -> None:
        """`name` finds the widget, `description` is what a screen reader says, the others are the axes' labels."""
        super().__init__()
        self.setObjectName(name)
        self.setAccessibleName(description)
        self.labels = {"bottom": across, "left": up}
        self._view: Any = None
        self._layout = set_spacing(QVBoxLayout(self), 0)
        EventListener(self, self.redraw, QEvent.Type.Show, QEvent.Type.PaletteChange)

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return the same size before the first drawing and after."""
        return QSize(*self.preferred_px)

    def redraw(self) -> None:
        """Draw again; a plot that is not visible is drawn when it is shown."""
        if not self.isVisible():
            return
        import pyqtgraph

        palette = self.palette()
        if self._view is None:
            self._view = pyqtgraph.PlotWidget()
            fill(self._layout, (self._view, 1))
        self._view.setBackground(palette.color(QPalette.ColorRole.Base))
        axes = self._view.getPlotItem()
        axes.clear()
        for side, label in self.labels.items():
            axis = axes.getAxis(side)
            axis.setPen(palette.color(QPalette.ColorRole.Mid))
            axis.setTextPen(palette.color(QPalette.ColorRole.WindowText))
            axis.setLabel(label, siPrefixEnableRanges=())  # values as they are, in the unit of the label
        self.draw(pyqtgraph, axes, get_theme_colours(palette))

    def draw(self, pyqtgraph: Any, axes: Any, ink: ThemeColours) -> None:
        """Draw the data on empty axes (a `pyqtgraph.PlotItem`)."""
        raise NotImplementedError
