"""Cells of a parameter sweep as a grid and as error against time; hovering a cell marks it in both."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from PyQt6.QtCore import QEvent, QPointF, QRectF, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QFontMetrics, QPainter, QPalette, QPen, QPixmap, QPolygonF
from PyQt6.QtWidgets import QSizePolicy, QToolTip, QWidget

from pipeline.evaluation.parameter_sweep import SweepCell
from pipeline.previews.preview import Preview
from widgets.preview_renderer import make_themed_qimage
from widgets.styling import EventListener
from widgets.theme import get_theme_colours, to_qcolor

CellIndex = tuple[int, int]  # row, col
_GAP_PX, _EDGE_PX = 3, 6
_LEFT_SHARE = 0.12  # of the width, for the values of the rows
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


class _CellView(QWidget):
    """Hovering and choosing of cells, common to grid and plot."""

    cell_chosen = pyqtSignal(int, int)
    cell_hovered = pyqtSignal(int, int)  # (-1, -1) = nothing

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setMouseTracking(True)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.cells: dict[CellIndex, SweepCell] = {}
        self.hovered_cell: CellIndex = (-1, -1)  # under the mouse, here or in the other view
        self.used_cell: CellIndex = (-1, -1)  # its values are in use
        self.unit = ""

    def mark_cell(self, row: int, col: int) -> None:
        """Mark a hovered cell."""
        if (row, col) != self.hovered_cell:
            self.hovered_cell = (row, col)
            self.update()

    def cell_at(self, at: QPointF) -> CellIndex:
        """The cell at a widget position; (-1, -1) = none."""
        raise NotImplementedError

    def mouseMoveEvent(self, a0: Any) -> None:  # noqa: N802
        """Emit the hovered cell and show its result."""
        index = self.cell_at(a0.position())
        self.cell_hovered.emit(*index)
        text = describe_cell(self.cells[index], self.unit) if index in self.cells else ""
        QToolTip.showText(a0.globalPosition().toPoint(), text, self)

    def leaveEvent(self, a0: Any) -> None:  # noqa: N802
        """Emit that no cell is hovered."""
        super().leaveEvent(a0)
        self.cell_hovered.emit(-1, -1)

    def mousePressEvent(self, a0: Any) -> None:  # noqa: N802
        """Choose the cell under the mouse."""
        index = self.cell_at(a0.position())
        if index in self.cells and not self.cells[index].problem:
            self.cell_chosen.emit(*index)


class SweepGrid(_CellView):
    """Grid of cells with preview, error and time; a cell is empty until it is computed."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("sweep_grid")
        self._across: tuple[str, Sequence[str]] = ("", ())
        self._down: tuple[str, Sequence[str]] = ("", ())
        self._thumbnails: dict[CellIndex, QPixmap] = {}
        EventListener(self, self._drop_thumbnails, QEvent.Type.Resize, QEvent.Type.PaletteChange)

    def show_axes(self, across: tuple[str, Sequence[str]], down: tuple[str, Sequence[str]], unit: str) -> None:
        """Show empty cells for (name, values) of columns and rows."""
        self._across, self._down, self.unit = across, down, unit
        self.cells, self._thumbnails = {}, {}
        self.update()

    def show_cell(self, cell: SweepCell) -> None:
        """Show one result."""
        self.cells[cell.row, cell.col] = cell
        self._thumbnails.pop((cell.row, cell.col), None)
        self.update()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Room for a few previews."""
        return QSize(560, 420)

    def cell_at(self, at: QPointF) -> CellIndex:
        """The cell at a widget position; (-1, -1) = none."""
        rows, cols = len(self._down[1]), len(self._across[1])
        for row in range(rows):
            for col in range(cols):
                if self._cell(row, col).contains(at):
                    return row, col
        return -1, -1

    def _drop_thumbnails(self) -> None:
        self._thumbnails = {}

    def _cell(self, row: int, col: int) -> QRectF:
        line = QFontMetrics(self.font()).height()
        named = QFontMetrics(self.font()).horizontalAdvance(self._down[0]) + 8.0
        left, top = max(70.0, named, _LEFT_SHARE * self.width()), 2.0 * line + _EDGE_PX
        wide = (self.width() - left - _EDGE_PX) / max(1, len(self._across[1]))
        high = (self.height() - top - _EDGE_PX) / max(1, len(self._down[1]))
        return QRectF(left + col * wide, top + row * high, wide - _GAP_PX, high - _GAP_PX)

    def paintEvent(self, a0: Any) -> None:  # noqa: N802
        """Draw names and values around the cells."""
        del a0
        painter, palette = QPainter(self), self.palette()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if not self._across[1]:
            return
        line = QFontMetrics(self.font()).height()
        middle = Qt.AlignmentFlag.AlignCenter
        painter.setPen(palette.color(QPalette.ColorRole.WindowText))
        first = self._cell(0, 0)
        painter.drawText(QRectF(first.left(), 0, self.width() - first.left(), line), middle, self._across[0])
        for col, value in enumerate(self._across[1]):
            cell = self._cell(0, col)
            painter.drawText(QRectF(cell.left(), line, cell.width(), line), middle, value)
        painter.drawText(QRectF(2, line, first.left() - 4, line), Qt.AlignmentFlag.AlignRight, self._down[0])
        for row, value in enumerate(self._down[1]):
            cell = self._cell(row, 0)
            label = QRectF(2, cell.top(), cell.left() - 8, cell.height())
            painter.drawText(label, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter, value)
            for col in range(len(self._across[1])):
                self._draw_cell(painter, row, col)

    def _draw_cell(self, painter: QPainter, row: int, col: int) -> None:
        room, cell, palette = self._cell(row, col), self.cells.get((row, col)), self.palette()
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


class SweepPlot(_CellView):
    """Error against time, both from zero; the Pareto front is joined by a line."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("sweep_plot")

    def show_cells(self, cells: Mapping[CellIndex, SweepCell], unit: str) -> None:
        """Show these cells."""
        self.cells, self.unit = dict(cells), unit
        self.update()

    def sizeHint(self) -> QSize:  # noqa: N802
        """About half the width of the grid."""
        return QSize(320, 320)

    def cell_at(self, at: QPointF) -> CellIndex:
        """The cell of the nearest point; (-1, -1) = none nearby."""
        near = {index: (self._point(index) - at).manhattanLength() for index in self._computed_cells}
        best = min(near, key=near.__getitem__, default=(-1, -1))
        return best if best in near and near[best] < _NEAR_PX else (-1, -1)

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

    def paintEvent(self, a0: Any) -> None:  # noqa: N802
        """Draw axes, points and the Pareto front."""
        del a0
        painter, palette, frame = QPainter(self), self.palette(), self._frame
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
        painter.setPen(QPen(to_qcolor(get_theme_colours(palette).accent), 1.5))
        painter.drawPolyline(QPolygonF([self._point(index) for index in front]))
        for index in measured:
            painter.setPen(
                QPen(palette.color(QPalette.ColorRole.WindowText), 2.5 if index == self.hovered_cell else 0.6)
            )
            painter.setBrush(
                to_qcolor(get_theme_colours(palette).accent if index in front else get_theme_colours(palette).worse)
            )
            radius = _DOT_PX + (3.0 if index == self.used_cell else 0.0)
            painter.drawEllipse(self._point(index), radius, radius)


def _format_time(ms: float) -> str:
    if not math.isfinite(ms):
        return "no time"
    return f"{ms:.0f} ms" if ms < 10_000 else f"{ms / 1e3:.1f} s"
