"""Cells of a parameter sweep as a grid and as error against time; hovering a cell marks it in both."""

import math
from collections.abc import Mapping, Sequence

from PyQt6.QtCore import QEvent, QPointF, QRectF, Qt
from PyQt6.QtGui import QFontMetrics, QPainter, QPalette, QPen, QPixmap, QPolygonF

from pipeline.evaluation.parameter_sweep import SweepCell
from pipeline.previews.preview import Preview
from widgets.base import EventListener
from widgets.cell_grid import NO_CELL, CellGrid, CellIndex, CellView
from widgets.preview_renderer import make_themed_qimage
from widgets.theme import ThemeColours, to_qcolor

_DOT_PX, _NEAR_PX = 5.0, 14.0


def describe_cell(cell: SweepCell, unit: str) -> str:
    """Error and time of a cell, or its problem."""
    if cell.problem:
        return cell.problem
    error = f"{cell.error:.3g} {unit}".strip() if math.isfinite(cell.error) else "no error known"
    return f"{error}, {_format_time(cell.ms)}"


def find_pareto_front(cells: Mapping[CellIndex, SweepCell]) -> list[CellIndex]:
    """Cells that no other beats in both time and error, by time."""
    measured = [(c.ms, c.error, index) for index, c in cells.items() if math.isfinite(c.error) and math.isfinite(c.ms)]
    front: list[CellIndex] = []
    least = math.inf
    for _, error, index in sorted(measured):
        if error < least:
            least = error
            front.append(index)
    return front


class SweepGrid(CellGrid):
    """Grid of cells with preview, error and time; a cell is empty until it is computed."""

    gap_px, preferred_px = 3.0, (560, 420)

    def __init__(self) -> None:
        super().__init__("sweep_grid")
        self.cells: dict[CellIndex, SweepCell] = {}
        self.unit = ""
        self._thumbnails: dict[CellIndex, QPixmap] = {}
        EventListener(self, self._drop_thumbnails, QEvent.Type.Resize, QEvent.Type.PaletteChange)

    def start_sweep(self, across: tuple[str, Sequence[str]], down: tuple[str, Sequence[str]], unit: str) -> None:
        """Show empty cells for (name, values) of columns and rows."""
        self.cells, self.unit, self._thumbnails = {}, unit, {}
        self.show_axes(across, down)

    def show_cell(self, cell: SweepCell) -> None:
        """Show one result."""
        index = cell.row, cell.col
        self.cells[index] = cell
        self._thumbnails.pop(index, None)
        self.add_cell(index, describe_cell(cell, self.unit), can_choose=not cell.problem)

    def _drop_thumbnails(self) -> None:
        self._thumbnails = {}

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Draw names and values around the cells."""
        del ink
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self.columns:
            self.draw_names(painter)
        for row in range(len(self.rows)):
            for col in range(len(self.columns)):
                self._draw_cell(painter, row, col)

    def _draw_cell(self, painter: QPainter, row: int, col: int) -> None:
        room, cell, palette = self.get_room(row, col), self.cells.get((row, col)), self.palette()
        rim = palette.color(QPalette.ColorRole.Mid)
        wide = 1.0
        if (row, col) == self.used_cell:
            rim, wide = palette.color(QPalette.ColorRole.Highlight), 3.0
        elif (row, col) == self.hovered_cell:
            rim, wide = palette.color(QPalette.ColorRole.WindowText), 2.0
        painter.setPen(QPen(rim, wide))
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
            small = QPixmap.fromImage(
                make_themed_qimage(self.palette(), preview).scaled(room.size().toSize(), fit, smooth)
            )
            self._thumbnails[index] = small
        left = room.left() + 0.5 * (room.width() - small.width())
        painter.drawPixmap(QPointF(left, room.top() + 0.5 * (room.height() - small.height())), small)


class SweepPlot(CellView):
    """Error against time, both from zero; the Pareto front is joined by a line."""

    preferred_px = 320, 320  # about half the width of the grid

    def __init__(self) -> None:
        super().__init__("sweep_plot")
        self.cells: dict[CellIndex, SweepCell] = {}
        self.unit = ""

    def show_unit(self, unit: str) -> None:
        """Show no cells; errors are in this unit."""
        self.cells, self.unit = {}, unit
        self.clear_cells()

    def show_cell(self, cell: SweepCell) -> None:
        """Show one result."""
        self.cells[cell.row, cell.col] = cell
        self.add_cell((cell.row, cell.col), describe_cell(cell, self.unit), can_choose=not cell.problem)

    def cell_at(self, at: QPointF) -> CellIndex:
        """The cell of the nearest point; (-1, -1) = none nearby."""
        near = {index: (self._point(index) - at).manhattanLength() for index in self._computed_cells}
        return min((index for index in near if near[index] < _NEAR_PX), key=near.__getitem__, default=NO_CELL)

    @property
    def _computed_cells(self) -> list[CellIndex]:
        return [index for index, c in self.cells.items() if math.isfinite(c.error) and math.isfinite(c.ms)]

    @property
    def _frame(self) -> QRectF:
        line = QFontMetrics(self.font()).height()
        return QRectF(52, line + 4, self.width() - 64, self.height() - 3 * line - 10)

    def _point(self, index: CellIndex) -> QPointF:
        frame, cell = self._frame, self.cells[index]
        max_ms = max(self.cells[i].ms for i in self._computed_cells) or 1.0
        max_error = max(self.cells[i].error for i in self._computed_cells) or 1.0
        x, y = cell.ms / (1.06 * max_ms), cell.error / (1.06 * max_error)
        return QPointF(frame.left() + x * frame.width(), frame.bottom() - y * frame.height())

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Draw axes, points and the Pareto front."""
        palette, frame = self.palette(), self._frame
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(QPen(palette.color(QPalette.ColorRole.Mid), 1))
        painter.drawLine(frame.bottomLeft(), frame.bottomRight())
        painter.drawLine(frame.bottomLeft(), frame.topLeft())
        painter.setPen(palette.color(QPalette.ColorRole.WindowText))
        measured = self._computed_cells
        line = QFontMetrics(self.font()).height()
        title = f"error, {self.unit}" if self.unit else "error"
        painter.drawText(QRectF(0, 0, self.width(), line), Qt.AlignmentFlag.AlignCenter, title)
        low = QRectF(frame.left(), frame.bottom() + 2, frame.width(), line)
        painter.drawText(low.translated(0, line), Qt.AlignmentFlag.AlignCenter, "time of the frame, without cache")
        if not measured:
            painter.drawText(frame, Qt.AlignmentFlag.AlignCenter, "no error known yet")
            return
        max_ms, max_error = max(self.cells[i].ms for i in measured), max(self.cells[i].error for i in measured)
        painter.drawText(low, Qt.AlignmentFlag.AlignLeft, "0")
        painter.drawText(low, Qt.AlignmentFlag.AlignRight, _format_time(1.06 * max_ms))
        painter.drawText(QRectF(0, frame.top() - 4, 48, line), Qt.AlignmentFlag.AlignRight, f"{1.06 * max_error:.3g}")
        front = find_pareto_front(self.cells)
        painter.setPen(QPen(to_qcolor(ink.accent), 1.5))
        painter.drawPolyline(QPolygonF([self._point(index) for index in front]))
        for index in measured:
            rim_px = 2.5 if index == self.hovered_cell else 0.6
            painter.setPen(QPen(palette.color(QPalette.ColorRole.WindowText), rim_px))
            painter.setBrush(to_qcolor(ink.accent if index in front else ink.worse))
            radius = _DOT_PX + (3.0 if index == self.used_cell else 0.0)
            painter.drawEllipse(self._point(index), radius, radius)


def _format_time(ms: float) -> str:
    if not math.isfinite(ms):
        return "no time"
    return f"{ms:.0f} ms" if ms < 10_000 else f"{ms / 1e3:.1f} s"
