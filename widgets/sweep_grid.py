"""A grid of tried pairs, and the same as time against error; the mouse over one marks the other."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from PyQt6.QtCore import QEvent, QPointF, QRectF, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QFontMetrics, QPainter, QPalette, QPen, QPixmap, QPolygonF
from PyQt6.QtWidgets import QSizePolicy, QToolTip, QWidget

from pipeline.previews.preview import Preview
from widgets.preview_renderer import make_themed_qimage
from widgets.theme import get_theme_colours, to_qcolor

CellIndex = tuple[int, int]  # row, col
_GAP_PX, _EDGE_PX = 3, 6
_LEFT_SHARE = 0.12  # of the width, for the rows' values
_DOT_PX, _NEAR_PX = 5.0, 14.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepTrial:
    """One pair of values: its error (NaN = not known), time and picture, or why it failed."""

    error: float
    time_ms: float
    preview: Preview | None
    problem: str = ""

    def describe(self, unit: str) -> str:
        """In a few words."""
        if self.problem:
            return self.problem
        error = f"{self.error:.3g} {unit}".strip() if math.isfinite(self.error) else "no error known"
        return f"{error}, {_time(self.time_ms)}"


def find_pareto_front(tried: Mapping[CellIndex, SweepTrial]) -> list[CellIndex]:
    """The places that no other beats in both time and error, by time."""
    known = [
        (t.time_ms, t.error, place) for place, t in tried.items() if math.isfinite(t.error) and math.isfinite(t.time_ms)
    ]
    front: list[CellIndex] = []
    least = math.inf
    for _, error, place in sorted(known):
        if error < least:
            least = error
            front.append(place)
    return front


class _Tries(QWidget):
    """What the two views of a sweep have in common."""

    cell_chosen = pyqtSignal(int, int)
    cell_hovered = pyqtSignal(int, int)  # (-1, -1) = nothing

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setMouseTracking(True)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.trials: dict[CellIndex, SweepTrial] = {}
        self.hovered_cell: CellIndex = (-1, -1)  # under the mouse, here or in the other
        self.used_cell: CellIndex = (-1, -1)  # whose values are the session's
        self.unit = ""

    def mark_cell(self, row: int, col: int) -> None:
        """Mark a place."""
        if (row, col) != self.hovered_cell:
            self.hovered_cell = (row, col)
            self.update()

    def cell_at(self, at: QPointF) -> CellIndex:
        """What lies there; (-1, -1) = nothing."""
        raise NotImplementedError

    def mouseMoveEvent(self, a0: Any) -> None:  # noqa: N802
        """Say what is under the mouse."""
        place = self.cell_at(a0.position())
        self.cell_hovered.emit(*place)
        told = self.trials[place].describe(self.unit) if place in self.trials else ""
        QToolTip.showText(a0.globalPosition().toPoint(), told, self)

    def leaveEvent(self, a0: Any) -> None:  # noqa: N802
        """Nothing is."""
        super().leaveEvent(a0)
        self.cell_hovered.emit(-1, -1)

    def mousePressEvent(self, a0: Any) -> None:  # noqa: N802
        """Use what is under the mouse."""
        place = self.cell_at(a0.position())
        if place in self.trials and not self.trials[place].problem:
            self.cell_chosen.emit(*place)


class SweepGrid(_Tries):
    """Rows over columns; each cell its picture, error and time, empty until it is worked out."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("sweep_grid")
        self._across: tuple[str, Sequence[str]] = ("", ())
        self._down: tuple[str, Sequence[str]] = ("", ())
        self._small: dict[CellIndex, QPixmap] = {}

    def show_axes(self, across: tuple[str, Sequence[str]], down: tuple[str, Sequence[str]], unit: str) -> None:
        """(name, values) of columns and rows; what was there before goes."""
        self._across, self._down, self.unit = across, down, unit
        self.trials, self._small = {}, {}
        self.update()

    def show_cell(self, row: int, col: int, tried: SweepTrial) -> None:
        """One more is known."""
        self.trials[row, col] = tried
        self._small.pop((row, col), None)
        self.update()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Room for a few small pictures."""
        return QSize(560, 420)

    def cell_at(self, at: QPointF) -> CellIndex:
        """The cell that lies there."""
        rows, cols = len(self._down[1]), len(self._across[1])
        for row in range(rows):
            for col in range(cols):
                if self._cell(row, col).contains(at):
                    return row, col
        return -1, -1

    def resizeEvent(self, a0: Any) -> None:  # noqa: N802
        """Small pictures of another size."""
        super().resizeEvent(a0)
        self._small = {}

    def changeEvent(self, a0: Any) -> None:  # noqa: N802
        """And in another theme on another ground."""
        super().changeEvent(a0)
        if a0.type() == QEvent.Type.PaletteChange:
            self._small = {}

    def _cell(self, row: int, col: int) -> QRectF:
        line = QFontMetrics(self.font()).height()
        named = QFontMetrics(self.font()).horizontalAdvance(self._down[0]) + 8.0
        left, top = max(70.0, named, _LEFT_SHARE * self.width()), 2.0 * line + _EDGE_PX
        wide = (self.width() - left - _EDGE_PX) / max(1, len(self._across[1]))
        high = (self.height() - top - _EDGE_PX) / max(1, len(self._down[1]))
        return QRectF(left + col * wide, top + row * high, wide - _GAP_PX, high - _GAP_PX)

    def paintEvent(self, a0: Any) -> None:  # noqa: N802
        """Names and values around the cells."""
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
            beside = QRectF(2, cell.top(), cell.left() - 8, cell.height())
            painter.drawText(beside, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter, value)
            for col in range(len(self._across[1])):
                self._draw_cell(painter, row, col)

    def _draw_cell(self, painter: QPainter, row: int, col: int) -> None:
        room, tried, palette = self._cell(row, col), self.trials.get((row, col)), self.palette()
        rim = palette.color(QPalette.ColorRole.Mid)
        wide = 1.0
        if (row, col) == self.used_cell:
            rim, wide = palette.color(QPalette.ColorRole.Highlight), 3.0
        elif (row, col) == self.hovered_cell:
            rim, wide = palette.color(QPalette.ColorRole.WindowText), 2.0
        painter.setPen(QPen(rim, wide))
        painter.setBrush(palette.color(QPalette.ColorRole.Base))
        painter.drawRoundedRect(room, 3, 3)
        if tried is None:
            return
        line = QFontMetrics(self.font()).height()
        if tried.preview is not None:
            self._draw_picture(painter, (row, col), tried.preview, room.adjusted(3, 3, -3, -line - 4))
        painter.setPen(palette.color(QPalette.ColorRole.WindowText))
        words = "failed" if tried.problem else tried.describe(self.unit)
        under = QRectF(room.left() + 3, room.bottom() - line - 2, room.width() - 6, line)
        text = QFontMetrics(self.font()).elidedText(words, Qt.TextElideMode.ElideRight, int(under.width()))
        painter.drawText(under, Qt.AlignmentFlag.AlignCenter, text)

    def _draw_picture(self, painter: QPainter, place: CellIndex, picture: Preview, room: QRectF) -> None:
        if room.width() < 8 or room.height() < 8:
            return
        small = self._small.get(place)
        if small is None:
            fit, smooth = Qt.AspectRatioMode.KeepAspectRatio, Qt.TransformationMode.SmoothTransformation
            small = QPixmap.fromImage(
                make_themed_qimage(self.palette(), picture).scaled(room.size().toSize(), fit, smooth)
            )
            self._small[place] = small
        left = room.left() + 0.5 * (room.width() - small.width())
        painter.drawPixmap(QPointF(left, room.top() + 0.5 * (room.height() - small.height())), small)


class SweepPlot(_Tries):
    """Time against error, both from zero; those that no other beats are joined."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("sweep_plot")

    def show_trials(self, tried: Mapping[CellIndex, SweepTrial], unit: str) -> None:
        """Show these."""
        self.trials, self.unit = dict(tried), unit
        self.update()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Half as wide as the grid."""
        return QSize(320, 320)

    def cell_at(self, at: QPointF) -> CellIndex:
        """The dot that lies there."""
        near = {place: (self._dot(place) - at).manhattanLength() for place in self._known}
        best = min(near, key=near.__getitem__, default=(-1, -1))
        return best if best in near and near[best] < _NEAR_PX else (-1, -1)

    @property
    def _known(self) -> list[CellIndex]:
        return [p for p, t in self.trials.items() if math.isfinite(t.error) and math.isfinite(t.time_ms)]

    @property
    def _frame(self) -> QRectF:
        line = QFontMetrics(self.font()).height()
        return QRectF(52, line + 4, self.width() - 64, self.height() - 3 * line - 10)

    def _dot(self, place: CellIndex) -> QPointF:
        frame, tried = self._frame, self.trials[place]
        most_ms = max(self.trials[p].time_ms for p in self._known) or 1.0
        most = max(self.trials[p].error for p in self._known) or 1.0
        x, y = tried.time_ms / (1.06 * most_ms), tried.error / (1.06 * most)
        return QPointF(frame.left() + x * frame.width(), frame.bottom() - y * frame.height())

    def paintEvent(self, a0: Any) -> None:  # noqa: N802
        """Axes with their ends, dots, and the line of the best."""
        del a0
        painter, palette, frame = QPainter(self), self.palette(), self._frame
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(QPen(palette.color(QPalette.ColorRole.Mid), 1))
        painter.drawLine(frame.bottomLeft(), frame.bottomRight())
        painter.drawLine(frame.bottomLeft(), frame.topLeft())
        painter.setPen(palette.color(QPalette.ColorRole.WindowText))
        known = self._known
        line = QFontMetrics(self.font()).height()
        title = f"error, {self.unit}" if self.unit else "error"
        painter.drawText(QRectF(0, 0, self.width(), line), Qt.AlignmentFlag.AlignCenter, title)
        low = QRectF(frame.left(), frame.bottom() + 2, frame.width(), line)
        painter.drawText(low.translated(0, line), Qt.AlignmentFlag.AlignCenter, "time of the frame, worked out afresh")
        if not known:
            painter.drawText(frame, Qt.AlignmentFlag.AlignCenter, "no error known yet")
            return
        most_ms, most = max(self.trials[p].time_ms for p in known), max(self.trials[p].error for p in known)
        painter.drawText(low, Qt.AlignmentFlag.AlignLeft, "0")
        painter.drawText(low, Qt.AlignmentFlag.AlignRight, _time(1.06 * most_ms))
        painter.drawText(QRectF(0, frame.top() - 4, 48, line), Qt.AlignmentFlag.AlignRight, f"{1.06 * most:.3g}")
        best = find_pareto_front(self.trials)
        painter.setPen(QPen(to_qcolor(get_theme_colours(palette).accent), 1.5))
        painter.drawPolyline(QPolygonF([self._dot(place) for place in best]))
        for place in known:
            painter.setPen(
                QPen(palette.color(QPalette.ColorRole.WindowText), 2.5 if place == self.hovered_cell else 0.6)
            )
            painter.setBrush(
                to_qcolor(get_theme_colours(palette).accent if place in best else get_theme_colours(palette).worse)
            )
            big = _DOT_PX + (3.0 if place == self.used_cell else 0.0)
            painter.drawEllipse(self._dot(place), big, big)


def _time(ms: float) -> str:
    if not math.isfinite(ms):
        return "no time"
    return f"{ms:.0f} ms" if ms < 10_000 else f"{ms / 1e3:.1f} s"
