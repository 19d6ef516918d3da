"""Cells of a grid of variants, and their error against time; hovering a cell marks it in both, a click chooses it."""

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from PyQt6.QtCore import QEvent, QPointF, QRectF, Qt, pyqtSignal
from PyQt6.QtGui import QFontMetrics, QPainter, QPalette, QPen, QPixmap
from PyQt6.QtWidgets import QToolTip

from pipeline.evaluation.grid_comparison import GridCell
from pipeline.previews.preview import Preview
from widgets.base import EventListener, PaintedWidget
from widgets.plots import Plot
from widgets.preview_renderer import make_themed_qimage
from widgets.theme import ThemeColours, to_qcolor

CellIndex = tuple[int, int]  # row, col
NO_CELL: CellIndex = (-1, -1)
_NAME_GAP_PX, _GAP_PX = 6.0, 3.0  # between the values of the rows and the cells; between cells


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


class CellGrid(PaintedWidget):
    """Cells in rows and columns with preview, error and time; a cell is empty until it is computed.

    The values of rows and columns stand at the left and at the top, under the name of the columns.
    """

    preferred_px = 560, 420
    cell_chosen = pyqtSignal(int, int)
    cell_hovered = pyqtSignal(int, int)  # (-1, -1) = nothing

    def __init__(self) -> None:
        super().__init__("comparison_grid", "results of the grid")
        self.setMouseTracking(True)
        self.cells: dict[CellIndex, GridCell] = {}
        self.unit = ""
        self.hovered_cell = self.used_cell = NO_CELL  # under the mouse, here or in the plot; chosen
        self._thumbnails: dict[CellIndex, QPixmap] = {}
        self._columns: tuple[str, Sequence[str]] = "", ()  # name, values
        self._rows: tuple[str, Sequence[str]] = "", ()
        EventListener(self, self._drop_thumbnails, QEvent.Type.Resize, QEvent.Type.PaletteChange)

    def show_axes(self, across: tuple[str, Sequence[str]], down: tuple[str, Sequence[str]], unit: str) -> None:
        """Show empty cells for (name, values) of columns and rows; errors are in `unit`."""
        self._columns, self._rows, self.unit = across, down, unit
        self.cells, self._thumbnails = {}, {}
        self.hovered_cell = self.used_cell = NO_CELL
        self.update()

    def show_cell(self, cell: GridCell) -> None:
        """Show one result."""
        self.cells[cell.row, cell.col] = cell
        self._thumbnails.pop((cell.row, cell.col), None)
        self.update()

    def mark_cell(self, row: int, col: int) -> None:
        """Mark a hovered cell."""
        if (row, col) != self.hovered_cell:
            self.hovered_cell = (row, col)
            self.update()

    def mark_used_cell(self, row: int, col: int) -> None:
        """Mark the cell that is in use."""
        self.used_cell = (row, col)
        self.update()

    def _drop_thumbnails(self) -> None:
        self._thumbnails = {}

    def get_room(self, row: int, col: int) -> QRectF:
        """Return the place of a cell."""
        metrics, (name, values) = self.fontMetrics(), self._rows
        left = max(metrics.horizontalAdvance(text) for text in (name, *values)) + 2 * _NAME_GAP_PX
        top = metrics.height() * 2.0 + _NAME_GAP_PX
        wide = (self.width() - left) / max(1, len(self._columns[1]))
        high = (self.height() - top) / max(1, len(values))
        return QRectF(left + col * wide, top + row * high, wide - _GAP_PX, high - _GAP_PX)

    def cell_at(self, at: QPointF) -> CellIndex:
        """Return the cell at a widget position; (-1, -1) = none."""
        return next((index for index in self._list_places() if self.get_room(*index).contains(at)), NO_CELL)

    def _list_places(self) -> list[CellIndex]:
        return [(row, col) for row in range(len(self._rows[1])) for col in range(len(self._columns[1]))]

    def mouseMoveEvent(self, a0: Any) -> None:  # noqa: N802
        """Emit the hovered cell and show its result."""
        index = self.cell_at(a0.position())
        self.cell_hovered.emit(*index)
        text = describe_cell(self.cells[index], self.unit) if index in self.cells else ""
        QToolTip.showText(a0.globalPosition().toPoint(), text, self)

    def leaveEvent(self, a0: Any) -> None:  # noqa: N802
        """Emit that no cell is hovered."""
        super().leaveEvent(a0)
        self.cell_hovered.emit(*NO_CELL)

    def mousePressEvent(self, a0: Any) -> None:  # noqa: N802
        """Choose the cell under the mouse, if it has a result."""
        cell = self.cells.get(self.cell_at(a0.position()))
        if cell is not None and not cell.problem:
            self.cell_chosen.emit(cell.row, cell.col)

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint cells, and names and values around them."""
        del ink
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self._columns[1]:
            self._draw_names(painter)
        for row, col in self._list_places():
            self._draw_cell(painter, row, col)

    def _draw_names(self, painter: QPainter) -> None:
        painter.setPen(self.palette().color(QPalette.ColorRole.WindowText))
        line, first = self.fontMetrics().height(), self.get_room(0, 0)
        top, left_px = first.top() - line - _NAME_GAP_PX, first.left() - _NAME_GAP_PX
        middle, right = Qt.AlignmentFlag.AlignCenter, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
        painter.drawText(QRectF(first.left(), 0, self.width() - first.left(), line), middle, self._columns[0])
        painter.drawText(QRectF(0, top, left_px, line), right, self._rows[0])
        for col, value in enumerate(self._columns[1]):
            room = self.get_room(0, col)
            text = self.fontMetrics().elidedText(value, Qt.TextElideMode.ElideLeft, int(room.width()))
            painter.drawText(QRectF(room.left(), top, room.width(), line), middle, text)
        for row, value in enumerate(self._rows[1]):
            room = self.get_room(row, 0)
            painter.drawText(QRectF(0, room.top(), left_px, room.height()), right, value)

    def _draw_cell(self, painter: QPainter, row: int, col: int) -> None:
        room, cell, palette = self.get_room(row, col), self.cells.get((row, col)), self.palette()
        rim, wide = QPalette.ColorRole.Mid, 1.0
        if (row, col) == self.used_cell:
            rim, wide = QPalette.ColorRole.Highlight, 3.0
        elif (row, col) == self.hovered_cell:
            rim, wide = QPalette.ColorRole.WindowText, 2.0
        painter.setPen(QPen(palette.color(rim), wide))
        painter.setBrush(palette.color(QPalette.ColorRole.Base))
        painter.drawRoundedRect(room, 3, 3)
        if cell is None:
            return
        line = QFontMetrics(self.font()).height()
        if cell.preview is not None:
            self._draw_preview(painter, (row, col), cell.preview, room.adjusted(3, 3, -3, -line - 4))
        painter.setPen(palette.color(QPalette.ColorRole.WindowText))
        words = "failed" if cell.problem else describe_cell(cell, self.unit)
        under = QRectF(room.left() + 3, room.bottom() - line - 2, room.width() - 6, line)
        text = QFontMetrics(self.font()).elidedText(words, Qt.TextElideMode.ElideRight, int(under.width()))
        painter.drawText(under, Qt.AlignmentFlag.AlignCenter, text)

    def _draw_preview(self, painter: QPainter, index: CellIndex, preview: Preview, room: QRectF) -> None:
        if room.width() < 8 or room.height() < 8:
            return
        small = self._thumbnails.get(index)
        if small is None:
            fit, smooth = Qt.AspectRatioMode.KeepAspectRatio, Qt.TransformationMode.SmoothTransformation
            image = make_themed_qimage(self.palette(), preview)
            small = self._thumbnails[index] = QPixmap.fromImage(image.scaled(room.size().toSize(), fit, smooth))
        left = room.left() + 0.5 * (room.width() - small.width())
        painter.drawPixmap(QPointF(left, room.top() + 0.5 * (room.height() - small.height())), small)


class CellPlot(Plot):
    """Error against time of the cells; the Pareto front is joined by a line."""

    cell_chosen = pyqtSignal(int, int)
    cell_hovered = pyqtSignal(int, int)  # (-1, -1) = nothing

    def __init__(self) -> None:
        super().__init__("comparison_plot", "error against time")
        self.cells: Mapping[CellIndex, GridCell] = {}
        self._unit = ""

    def show_cells(self, cells: Mapping[CellIndex, GridCell], unit: str) -> None:
        """Show these cells, with errors in `unit`."""
        self.cells, self._unit = cells, unit
        self.redraw()

    def draw(self, pyqtgraph: Any, ink: ThemeColours) -> None:
        """Draw the points and the Pareto front."""
        error = f"error, {self._unit}" if self._unit else "error"
        axes = self.prepare_axes(0, "time of the frame without cache, ms", error)
        front, measured = find_pareto_front(self.cells.values()), _list_measured(self.cells.values())
        axes.plot(
            [c.ms for c in front], [c.error for c in front], pen=pyqtgraph.mkPen(to_qcolor(ink.accent), width=1.5)
        )
        points = pyqtgraph.ScatterPlotItem(
            [c.ms for c in measured], [c.error for c in measured], data=[(c.row, c.col) for c in measured], size=10,
            brush=[to_qcolor(ink.accent if c in front else ink.worse) for c in measured], hoverable=True, hoverSize=15,
        )  # fmt: skip
        points.sigClicked.connect(partial(self._emit_cell, self.cell_chosen))
        points.sigHovered.connect(partial(self._emit_cell, self.cell_hovered))
        axes.addItem(points)
        axes.setLimits(xMin=0.0, yMin=0.0)

    def _emit_cell(self, signal: Any, _: object, points: Sequence[Any], *__: object) -> None:
        """Emit the cell of the first of these points, or none."""
        signal.emit(*(points[0].data() if len(points) else NO_CELL))
