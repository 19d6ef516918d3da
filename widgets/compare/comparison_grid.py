"""Cells of a grid of variants, with error and time; those that no other beats in both are bold.

A click on a cell chooses it.
"""

import math
from collections.abc import Iterable, Sequence

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
from widgets.style.styling import format_time, name_widget
from widgets.views.preview_renderer import make_themed_qimage

CellIndex = tuple[int, int]  # row, col
_GAP_PX = 4  # around the image of a cell


def describe_cell(cell: GridCell, unit: str) -> str:
    """Error and time of a cell, or its problem."""
    if cell.problem:
        return cell.problem
    error = f"{cell.error:.3g} {unit}".strip() if math.isfinite(cell.error) else "no error known"
    return f"{error}, {format_time(cell.ms) if math.isfinite(cell.ms) else 'no time'}"


def find_pareto_front(cells: Iterable[GridCell]) -> list[GridCell]:
    """Cells that no other beats in both time and error, by time."""
    front: list[GridCell] = []
    measured = [cell for cell in cells if math.isfinite(cell.error) and math.isfinite(cell.ms)]
    for cell in sorted(measured, key=lambda cell: (cell.ms, cell.error)):
        if not front or cell.error < front[-1].error:
            front.append(cell)
    return front


class CellGrid(QTableWidget):
    """Table of the cells with preview, error and time; a cell is empty until it is computed.

    The values of rows and columns are the headers. A click, or Enter, chooses a cell with a result.
    """

    cell_chosen = pyqtSignal(int, int)

    def __init__(self) -> None:
        super().__init__()
        name_widget(self, "comparison_grid", "results of the grid")
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
        front = find_pareto_front(self.cells.values())
        for place, known in self.cells.items():
            if (shown := self.item(*place)) is not None:
                font = self.font()
                font.setBold(known in front)
                shown.setFont(font)

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
