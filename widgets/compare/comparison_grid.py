"""Cells of a grid of variants, and their error against time.

A click on a cell, here or there, chooses it.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from PyQt6.QtCore import QEvent, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QIcon, QPixmap
from PyQt6.QtWidgets import (
    QAbstractItemView,
    QHeaderView,
    QStyleOptionViewItem,
    QTableWidget,
    QTableWidgetItem,
)

from pipeline.lab.evaluation.grid_comparison import GridCell
from widgets.style.base import EventListener
from widgets.style.plots import Plot
from widgets.style.theme import ThemeColours, to_qcolor
from widgets.views.preview_renderer import make_themed_qimage

CellIndex = tuple[int, int]  # row, col
_GAP_PX = 4  # around the image of a cell


def describe_cell(cell: GridCell, unit: str) -> str:
    """Error and time of a cell, or its problem."""
    if cell.problem:
        return cell.problem
    error = f"{cell.error:.3g} {unit}".strip() if math.isfinite(cell.error) else "no error known"
    return f"{error}, {_format_time(cell.ms)}"


def _format_time(ms: float) -> str:
    if not math.isfinite(ms):
        return "no time"
    return f"{ms:.0f} ms" if ms < 10_000 else f"{ms / 1e3:.1f} s"


def find_pareto_front(cells: Iterable[GridCell]) -> list[GridCell]:
    """Cells that no other beats in both time and error, by time."""
    front: list[GridCell] = []
    for cell in sorted(_list_measured(cells), key=lambda cell: (cell.ms, cell.error)):
        if not front or cell.error < front[-1].error:
            front.append(cell)
    return front


def _list_measured(cells: Iterable[GridCell]) -> list[GridCell]:
    return [cell for cell in cells if math.isfinite(cell.error) and math.isfinite(cell.ms)]


class CellGrid(QTableWidget):
    """Table of the cells with preview, error and time; a cell is empty until it is computed.

    The values of rows and columns are the headers. A click, or Enter, chooses a cell with a result.
    """

    cell_chosen = pyqtSignal(int, int)

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("comparison_grid")
        self.setAccessibleName("results of the grid")
        self.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.cells: dict[CellIndex, GridCell] = {}
        self.unit = ""
        for header in (self.horizontalHeader(), self.verticalHeader()):
            assert header is not None
            header.setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
        for chosen in (self.cellClicked, self.cellActivated):
            chosen.connect(self._choose)
        viewport = self.viewport()
        assert viewport is not None
        EventListener(viewport, self._fit_images, QEvent.Type.Resize)
        EventListener(self, self._draw_cells, QEvent.Type.PaletteChange)

    def initViewItemOption(self, option: QStyleOptionViewItem | None) -> None:  # noqa: N802
        """Put the text of a cell under its image."""
        super().initViewItemOption(option)
        if option is not None:
            option.decorationPosition = QStyleOptionViewItem.Position.Top
            option.decorationAlignment = Qt.AlignmentFlag.AlignCenter
            option.displayAlignment = Qt.AlignmentFlag.AlignHCenter | Qt.AlignmentFlag.AlignTop

    def show_axes(self, across: Sequence[str], down: Sequence[str], unit: str) -> None:
        """Show empty cells for these values of columns and rows; errors are in `unit`."""
        self.cells = {}
        self.unit = unit
        self.clear()
        self.setRowCount(len(down))
        self.setColumnCount(len(across))
        self.setVerticalHeaderLabels(down)
        self.setHorizontalHeaderLabels(across)
        self._fit_images()

    def show_cell(self, cell: GridCell) -> None:
        """Show one result."""
        self.cells[cell.row, cell.col] = cell
        text = describe_cell(cell, self.unit)
        item = QTableWidgetItem("failed" if cell.problem else text)
        item.setToolTip(text)
        if cell.preview is not None:
            image = make_themed_qimage(self.palette(), cell.preview)
            fit = Qt.AspectRatioMode.KeepAspectRatio
            smooth = Qt.TransformationMode.SmoothTransformation
            item.setIcon(QIcon(QPixmap.fromImage(image.scaled(self.iconSize(), fit, smooth))))
        self.setItem(cell.row, cell.col, item)

    def _draw_cells(self) -> None:
        for cell in self.cells.values():
            self.show_cell(cell)

    def _fit_images(self) -> None:
        """Make images as large as the cells, above their text."""
        room = self.viewport()
        rows = max(1, self.rowCount())
        columns = max(1, self.columnCount())
        if room is not None:
            high = room.height() // rows - self.fontMetrics().height() - 2 * _GAP_PX
            self.setIconSize(QSize(room.width() // columns - 2 * _GAP_PX, max(high, 1)))
            self._draw_cells()  # an icon is never enlarged

    def _choose(self, row: int, col: int) -> None:
        cell = self.cells.get((row, col))
        if cell is not None and not cell.problem:
            self.cell_chosen.emit(row, col)


class CellPlot(Plot):
    """Error against time of the cells; the Pareto front is joined by a line."""

    cell_chosen = pyqtSignal(int, int)

    def __init__(self) -> None:
        super().__init__("comparison_plot", "error against time")
        self.cells: Mapping[CellIndex, GridCell] = {}
        self._unit = ""

    def show_cells(self, cells: Mapping[CellIndex, GridCell], unit: str) -> None:
        """Show these cells, with errors in `unit`."""
        self.cells = cells
        self._unit = unit
        self.redraw()

    def draw(self, pyqtgraph: Any, ink: ThemeColours) -> None:
        """Draw the points and the Pareto front."""
        error = f"error, {self._unit}" if self._unit else "error"
        axes = self.prepare_axes(pyqtgraph, 0, "time of the frame without cache, ms", error)
        front = find_pareto_front(self.cells.values())
        measured = _list_measured(self.cells.values())
        axes.plot(
            [c.ms for c in front],
            [c.error for c in front],
            pen=pyqtgraph.mkPen(to_qcolor(ink.accent), width=1.5),
        )
        points = pyqtgraph.ScatterPlotItem(
            [c.ms for c in measured],
            [c.error for c in measured],
            data=[(c.row, c.col) for c in measured],
            size=10,
            brush=[to_qcolor(ink.accent if c in front else ink.worse) for c in measured],
            hoverable=True,
            hoverSize=15,
            tip=self._describe_point,
        )
        points.sigClicked.connect(self._choose)
        axes.view.addItem(points)
        axes.view.setLimits(xMin=0.0, yMin=0.0)

    def _describe_point(self, x: float, y: float, data: CellIndex) -> str:
        del x, y
        return (
            f"row {data[0] + 1}, column {data[1] + 1}: "
            f"{describe_cell(self.cells[data], self._unit)}"
        )

    def _choose(self, _: object, points: Sequence[Any], *__: object) -> None:
        self.cell_chosen.emit(*points[0].data())
