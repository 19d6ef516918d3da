"""Plots in the theme's colours, with pan, zoom and export.

Pyqtgraph is imported when the first one is shown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
from PyQt6.QtCore import QEvent, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QWidget

from pipeline.core.frozen import frozen
from widgets.style.base import EventListener
from widgets.style.styling import fill, make_column, name_widget
from widgets.style.theme import ThemeColours, get_theme_colours, to_hex, to_qcolor

_LABEL_PX = 52  # width of the numbers at the left: axes above each other begin at the same place
_GRID_ALPHA = 40
# most names of steps; opacity of bands, and behind titles
_N_LABELS = 8
_BAND_ALPHA = 60
_COVER_ALPHA = 200
# of the curves of a strip
_STYLES = Qt.PenStyle.SolidLine, Qt.PenStyle.DashLine, Qt.PenStyle.DotLine


class Plot(QWidget):
    """Axes above each other; subclasses override `draw`, and call `redraw` when their data
    change.
    """

    preferred_px = 320, 320  # width, height

    def __init__(self, name: str, description: str) -> None:
        """`name` finds the widget, `description` is what a screen reader says."""
        super().__init__()
        name_widget(self, name, description)
        self._view: Any = None
        self._axes: list[Axes] = []
        self._layout = make_column(0, on=self)
        EventListener(self, self.redraw, QEvent.Type.Show, QEvent.Type.PaletteChange)
        self.setContextMenuPolicy(Qt.ContextMenuPolicy.ActionsContextMenu)
        for text, act in (("View all", self._view_all), ("Export…", self._export)):
            action = QAction(text, self)
            action.triggered.connect(act)
            self.addAction(action)

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return the same size before the first drawing and after."""
        return QSize(*self.preferred_px)

    def redraw(self) -> None:
        """Draw again; a plot that is not visible is drawn when it is shown."""
        if not self.isVisible():
            return
        import pyqtgraph

        if self._view is None:
            self._view = pyqtgraph.GraphicsLayoutWidget()
            for part in (self._view, self._view.viewport()):
                part.setFocusPolicy(Qt.FocusPolicy.NoFocus)
            # this widget has one
            self._view.setContextMenuPolicy(Qt.ContextMenuPolicy.NoContextMenu)
            self._view.ci.layout.setSpacing(2)
            self._view.scene().sigMouseClicked.connect(self.handle_click)
            fill(self._layout, (self._view, 1))
        self._view.setBackground(self.palette().base())
        for axes in self._axes:
            axes.view.clear()
        self.draw(pyqtgraph, get_theme_colours(self.palette()))

    def draw(self, pyqtgraph: Any, ink: ThemeColours) -> None:
        """Draw the data on axes from `prepare_axes`."""
        raise NotImplementedError

    def handle_click(self, event: Any) -> None:
        """Handle a click (a `pyqtgraph` event of the scene)."""

    def prepare_axes(self, pyqtgraph: Any, row: int, across: str = "", up: str = "") -> Axes:
        """Return the empty axes of a row, with these labels; pan and zoom stay."""
        while len(self._axes) <= row:
            self._axes.append(Axes(pyqtgraph, self._view, len(self._axes)))
            if len(self._axes) > 1:
                self._axes[-1].view.setXLink(self._axes[0].view)
        palette = self.palette()
        axes = self._axes[row]
        for axis, label in ((axes.bottom, across), (axes.left, up)):
            axis.setPen(palette.mid().color())
            axis.setTextPen(palette.windowText().color())
            # values as they are, in the unit of the label
            axis.setLabel(label, siPrefixEnableRanges=())
        return axes

    def _view_all(self) -> None:
        for axes in self._axes:
            axes.view.autoRange()

    def _export(self) -> None:
        if self._axes:
            scene = self._view.scene()
            scene.contextMenuItem = self._axes[0].view
            scene.showExportDialog()


class Axes:
    """A view of data with an axis at its left and one below.

    A `pyqtgraph.PlotItem` brings menus of 60 controls.
    """

    def __init__(self, pyqtgraph: Any, layout: Any, row: int) -> None:
        self._pyqtgraph = pyqtgraph
        self.view = pyqtgraph.ViewBox(enableMenu=False)
        self.left, self.bottom = (
            pyqtgraph.AxisItem(side, linkView=self.view) for side in ("left", "bottom")
        )
        self.left.setWidth(_LABEL_PX)
        self.left.setGrid(_GRID_ALPHA)
        self.left.setZValue(-1000)  # its grid is below the curves
        layout.addItem(self.left, row=2 * row, col=0)
        layout.addItem(self.view, row=2 * row, col=1)
        layout.addItem(self.bottom, row=2 * row + 1, col=1)

    def plot(self, *data: Any, **style: Any) -> Any:
        """Add a curve or points (a `pyqtgraph.PlotDataItem`)."""
        item = self._pyqtgraph.PlotDataItem(*data, **style)
        self.view.addItem(item)
        return item


@frozen
class Strip:
    """Curves over the same steps, on axes of their own."""

    title: str  # with the unit
    curves: Sequence[tuple[str, Sequence[float]]]  # name, and a value per step; NaN = none
    has_axis_colours: bool = False  # curves are x, y and z
    least_span: float = 0.0  # noise does not fill the axes


class StripPlot(Plot):
    """Strips over the same steps with a cursor.

    A click, a drag of the cursor or an arrow key chooses a step.
    """

    step_chosen = pyqtSignal(int)
    preferred_px = (400, 130)
    across = "step"

    def __init__(self, name: str, description: str) -> None:
        super().__init__(name, description)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.strips: Sequence[Strip] = ()
        self.marks: Sequence[int] = ()
        self._labels: Sequence[str] = ()
        self._bands: Sequence[tuple[int, int, bool]] = ()
        self._turns: Sequence[int] = ()
        self._cursors: list[Any] = []
        self.current_step = -1

    def show_strips(
        self,
        strips: Sequence[Strip],
        labels: Sequence[str] = (),
        *,
        marks: Sequence[int] = (),
        bands: Sequence[tuple[int, int, bool]] = (),
        turns: Sequence[int] = (),
    ) -> None:
        """Show strips over steps that `labels` name, by default by their numbers.

        `marks` are steps with a triangle at the top, `bands` (first, last, is bad) are steps with a
        background, and a line stands before each of the `turns`.
        """
        self.strips = strips
        self._labels = labels
        self.marks = marks
        self._bands = bands
        self._turns = turns
        self.redraw()

    def show_step(self, at: int) -> None:
        """Mark a step."""
        self.current_step = at
        for cursor in self._cursors:
            cursor.setValue(at)

    @property
    def n_steps(self) -> int:
        """Number of steps."""
        return len(self.strips[0].curves[0][1]) if self.strips else 0

    def draw(self, pyqtgraph: Any, ink: ThemeColours) -> None:
        """Draw the strips."""
        for axes in self._axes[len(self.strips) :]:
            for item in (axes.left, axes.view, axes.bottom):
                self._view.removeItem(item)
        del self._axes[len(self.strips) :]
        self._cursors = [
            self._draw_strip(pyqtgraph, ink, row, strip) for row, strip in enumerate(self.strips)
        ]

    def _draw_strip(self, pyqtgraph: Any, ink: ThemeColours, row: int, strip: Strip) -> Any:
        """Draw a strip; returns its cursor."""
        is_last = row == len(self.strips) - 1
        palette = self.palette()
        axes = self.prepare_axes(pyqtgraph, row, self.across if is_last else "")
        axes.bottom.setVisible(is_last)
        every = max(1, len(self._labels) // _N_LABELS)
        ticks = list(enumerate(self._labels))[::every]
        axes.bottom.setTicks([ticks] if ticks else None)
        for first, last, is_bad in self._bands:
            axes.view.addItem(
                pyqtgraph.LinearRegionItem(
                    (first - 0.5, last + 0.5),
                    movable=False,
                    brush=to_qcolor(ink.worse, _BAND_ALPHA) if is_bad else palette.midlight(),
                    pen=pyqtgraph.mkPen(None),
                )
            )
        for turn in self._turns:
            pen = pyqtgraph.mkPen(palette.mid().color(), style=Qt.PenStyle.DashLine)
            axes.view.addItem(pyqtgraph.InfiniteLine(turn - 0.5, pen=pen))
        colours = ink.axes if strip.has_axis_colours else (ink.accent, ink.worse)
        words = [_colour(palette.windowText().color().name(), strip.title)]
        for (name, values), colour, style in zip(strip.curves, colours, _STYLES, strict=False):
            pen = pyqtgraph.mkPen(to_qcolor(colour), width=1.5, style=style)
            heights = np.asarray(values, np.float64)
            axes.plot(heights, pen=pen, connect="finite", antialias=True)
            words.append(_colour(to_hex(colour), name))
        known = [value for _, values in strip.curves for value in values if math.isfinite(value)]
        low = min((0.0, *known))
        high = max((low + strip.least_span, *known))
        axes.view.setYRange(low, high)
        if row == 0 and self.marks:
            axes.plot(
                self.marks,
                [high] * len(self.marks),
                pen=None,
                symbol="t",
                symbolBrush=to_qcolor(ink.worse),
                symbolPen=None,
            )
        cover = palette.base().color()
        cover.setAlpha(_COVER_ALPHA)
        title = pyqtgraph.TextItem(html=" &nbsp; ".join(words), anchor=(0, 0), fill=cover)
        axes.view.addItem(title, ignoreBounds=True)
        title.setPos(0, high)
        cursor = pyqtgraph.InfiniteLine(
            self.current_step, movable=True, pen=pyqtgraph.mkPen(to_qcolor(ink.accent), width=2)
        )
        cursor.sigPositionChanged.connect(self._follow_cursor)
        axes.view.addItem(cursor)
        return cursor

    def _follow_cursor(self, cursor: Any) -> None:
        self._choose(round(cursor.value()))

    def handle_click(self, event: Any) -> None:
        """Choose the step at this position."""
        if self._axes:
            self._choose(round(self._axes[0].view.mapSceneToView(event.scenePos()).x()))

    def _choose(self, at: int) -> None:
        at = min(max(at, 0), self.n_steps - 1)
        if self.n_steps and at != self.current_step:
            self.step_chosen.emit(at)

    def keyPressEvent(self, a0: Any) -> None:  # noqa: N802
        """Choose the next, previous, first or last step."""
        ways = {
            Qt.Key.Key_Left: self.current_step - 1,
            Qt.Key.Key_Right: self.current_step + 1,
            Qt.Key.Key_Home: 0,
            Qt.Key.Key_End: self.n_steps - 1,
        }
        if a0.key() in ways:
            self._choose(ways[a0.key()])
        else:
            super().keyPressEvent(a0)


def _colour(colour: str, text: str) -> str:
    return f"<span style='color: {colour}'>{escape(text)}</span>"
