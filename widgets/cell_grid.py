"""Cells of a table of results: hovering shows what a cell holds, a click chooses it."""

from collections.abc import Sequence
from typing import Any

from PyQt6.QtCore import QPointF, QRectF, Qt, pyqtSignal
from PyQt6.QtGui import QPainter, QPalette
from PyQt6.QtWidgets import QToolTip

from widgets.base import PaintedWidget

CellIndex = tuple[int, int]  # row, col
NO_CELL: CellIndex = (-1, -1)
_NAME_GAP_PX = 6.0  # between the values of the rows and the cells


class CellView(PaintedWidget):
    """Hovering and choosing of cells, wherever they are drawn."""

    cell_chosen = pyqtSignal(int, int)
    cell_hovered = pyqtSignal(int, int)  # (-1, -1) = nothing

    def __init__(self, name: str, description: str = "") -> None:
        super().__init__(name, description)
        self.setMouseTracking(True)
        self._tips: dict[CellIndex, str] = {}
        self._choosable = frozenset[CellIndex]()
        self.hovered_cell = self.used_cell = NO_CELL  # under the mouse, here or in another view; chosen

    def cell_at(self, at: QPointF) -> CellIndex:
        """Return the cell at a widget position; (-1, -1) = none."""
        raise NotImplementedError

    def add_cell(self, index: CellIndex, tip: str, *, can_choose: bool) -> None:
        """Add a cell with a tooltip, and set whether it can be chosen."""
        self._tips[index] = tip
        self._choosable = self._choosable | {index} if can_choose else self._choosable - {index}
        self.update()

    def clear_cells(self) -> None:
        """Remove all cells."""
        self._tips, self._choosable = {}, frozenset()
        self.hovered_cell = self.used_cell = NO_CELL
        self.update()

    def choose_cell(self, row: int, col: int) -> None:
        """Choose a cell, if it can be."""
        if (row, col) in self._choosable:
            self.cell_chosen.emit(row, col)

    def mark_cell(self, row: int, col: int) -> None:
        """Mark a hovered cell."""
        if (row, col) != self.hovered_cell:
            self.hovered_cell = (row, col)
            self.update()

    def mark_used_cell(self, row: int, col: int) -> None:
        """Mark the cell that is in use."""
        self.used_cell = (row, col)
        self.update()

    def mouseMoveEvent(self, a0: Any) -> None:  # noqa: N802
        """Emit the hovered cell and show its result."""
        index = self.cell_at(a0.position())
        self.cell_hovered.emit(*index)
        QToolTip.showText(a0.globalPosition().toPoint(), self._tips.get(index, ""), self)

    def leaveEvent(self, a0: Any) -> None:  # noqa: N802
        """Emit that no cell is hovered."""
        super().leaveEvent(a0)
        self.cell_hovered.emit(*NO_CELL)

    def mousePressEvent(self, a0: Any) -> None:  # noqa: N802
        """Choose the cell under the mouse."""
        self.choose_cell(*self.cell_at(a0.position()))


class CellGrid(CellView):
    """Cells in rows and columns, with their values at the left and at the top, under the name of the columns."""

    gap_px = 1.0

    def __init__(self, name: str, description: str = "") -> None:
        super().__init__(name, description)
        self.rows: Sequence[str] = ()  # value of each
        self.columns: Sequence[str] = ()
        self._row_name = self._column_name = ""

    def show_axes(self, across: tuple[str, Sequence[str]], down: tuple[str, Sequence[str]]) -> None:
        """Show these names and values of columns and rows, without cells."""
        (self._column_name, self.columns), (self._row_name, self.rows) = across, down
        self.clear_cells()

    def get_room(self, row: int, col: int) -> QRectF:
        """Return the place of a cell."""
        metrics = self.fontMetrics()
        names = (self._row_name, *self.rows)
        left = max(metrics.horizontalAdvance(name) for name in names) + 2 * _NAME_GAP_PX
        top = metrics.height() * (2.0 if self._column_name else 1.0) + _NAME_GAP_PX
        wide, high = (self.width() - left) / max(1, len(self.columns)), (self.height() - top) / max(1, len(self.rows))
        return QRectF(left + col * wide, top + row * high, wide - self.gap_px, high - self.gap_px)

    def cell_at(self, at: QPointF) -> CellIndex:
        """Return the cell at a widget position; (-1, -1) = none."""
        cells = ((row, col) for row in range(len(self.rows)) for col in range(len(self.columns)))
        return next((index for index in cells if self.get_room(*index).contains(at)), NO_CELL)

    def draw_names(self, painter: QPainter) -> None:
        """Draw names and values around the cells."""
        painter.setPen(self.palette().color(QPalette.ColorRole.WindowText))
        line, first = self.fontMetrics().height(), self.get_room(0, 0)
        top, left_px = first.top() - line - _NAME_GAP_PX, first.left() - _NAME_GAP_PX
        middle, right = Qt.AlignmentFlag.AlignCenter, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
        painter.drawText(QRectF(first.left(), 0, self.width() - first.left(), line), middle, self._column_name)
        painter.drawText(QRectF(0, top, left_px, line), right, self._row_name)
        for col, value in enumerate(self.columns):
            room = self.get_room(0, col)
            if room.width() > self.fontMetrics().horizontalAdvance(value) or col % 2 == 0:
                painter.drawText(QRectF(room.left() - 12, top, room.width() + 24, line), middle, value)
        for row, value in enumerate(self.rows):
            room = self.get_room(row, 0)
            painter.drawText(QRectF(0, room.top(), left_px, room.height()), right, value)
