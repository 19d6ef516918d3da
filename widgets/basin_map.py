"""Map of where a registration ends for a grid of starts: one colour and letter per pose; a click shows that pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from PyQt6.QtCore import QPointF, QRectF, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QColor, QFontMetrics, QPainter, QPalette, QPen
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QSizePolicy, QToolTip, QVBoxLayout, QWidget

from widgets.choice_box import ChoiceBox
from widgets.fonts import resize_font
from widgets.run_bar import RunBar
from widgets.styling import set_spacing
from widgets.theme import CATEGORY_COLOURS, to_qcolor

CellIndex = tuple[int, int]  # row, col
_LEFT_PX, _GAP_PX = 62.0, 1.0
_OTHER = (170, 174, 182)  # colour of poses without a colour of their own
_NARROW_PX = 26.0  # narrower cells have no number


@dataclass(frozen=True, slots=True, kw_only=True)
class BasinCell:
    """One start: the index of the pose it ended in (-1 = none), and how well that fits."""

    pose_index: int
    rmse_mm: float
    tooltip: str


class BasinMap(QWidget):
    """Rows are translations, columns rotations; the start at the centre is the pose itself."""

    cell_chosen = pyqtSignal(int, int)  # row, col

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("basin_map")
        self.setMouseTracking(True)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setAccessibleName("result of the registration from each start; arrow keys select one")
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        resize_font(self)
        self.cells: tuple[tuple[BasinCell, ...], ...] = ()
        self._columns: Sequence[str] = ()
        self._rows: Sequence[str] = ()
        self._corner = ""
        self.selected_cell: CellIndex = (-1, -1)  # row, col

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return a size with room for all rows."""
        return QSize(640, 170)

    def show_map(
        self, cells: Sequence[Sequence[BasinCell]], rows: Sequence[str], columns: Sequence[str], corner: str
    ) -> None:
        """Show these cells, row and column labels; clear the map for no cells."""
        self.cells = tuple(tuple(row) for row in cells)
        self._rows, self._columns, self._corner = tuple(rows), tuple(columns), corner
        self.selected_cell = (-1, -1)
        self.update()

    def choose_cell(self, row: int, col: int) -> None:
        """Select a start and show the pose it ended in."""
        if 0 <= row < len(self.cells) and 0 <= col < len(self.cells[row]) and self.cells[row][col].pose_index >= 0:
            self.selected_cell = (row, col)
            self.update()
            self.cell_chosen.emit(row, col)

    def cell_at(self, at: QPointF) -> CellIndex:
        """Return (row, col) of the start at a point; (-1, -1) = none."""
        for row, cells in enumerate(self.cells):
            for col in range(len(cells)):
                if self._room(row, col).contains(at):
                    return row, col
        return -1, -1

    def _room(self, row: int, col: int) -> QRectF:
        line = QFontMetrics(self.font()).height()
        wide = (self.width() - _LEFT_PX) / max(1, len(self._columns))
        high = (self.height() - line) / max(1, len(self._rows))
        return QRectF(_LEFT_PX + col * wide, line + row * high, wide - _GAP_PX, high - _GAP_PX)

    def mouseMoveEvent(self, a0: Any) -> None:  # noqa: N802
        """Show the result of the start under the mouse."""
        row, col = self.cell_at(a0.position())
        QToolTip.showText(a0.globalPosition().toPoint(), self.cells[row][col].tooltip if row >= 0 else "", self)

    def mousePressEvent(self, a0: Any) -> None:  # noqa: N802
        """Select the start under the mouse."""
        self.choose_cell(*self.cell_at(a0.position()))

    def keyPressEvent(self, a0: Any) -> None:  # noqa: N802
        """Move the selection with the arrow keys."""
        steps = {Qt.Key.Key_Left: (0, -1), Qt.Key.Key_Right: (0, 1), Qt.Key.Key_Up: (-1, 0), Qt.Key.Key_Down: (1, 0)}
        if a0.key() not in steps or not self.cells:
            super().keyPressEvent(a0)
            return
        down, right = steps[a0.key()]
        row, col = self.selected_cell if self.selected_cell[0] >= 0 else (len(self._rows) // 2, len(self._columns) // 2)
        self.choose_cell(min(max(row + down, 0), len(self._rows) - 1), (col + right) % len(self._columns))

    def paintEvent(self, a0: Any) -> None:  # noqa: N802
        """Paint the cells in the colours of their poses, with letter and rmse."""
        del a0
        if not self.cells:
            return
        painter, palette = QPainter(self), self.palette()
        metrics = QFontMetrics(self.font())
        line, text = metrics.height(), palette.color(QPalette.ColorRole.WindowText)
        painter.setPen(text)
        middle = Qt.AlignmentFlag.AlignCenter
        painter.drawText(QRectF(0, 0, _LEFT_PX - 6, line), Qt.AlignmentFlag.AlignRight, self._corner)
        for col, word in enumerate(self._columns):
            room = self._room(0, col)
            if room.width() > metrics.horizontalAdvance(word) or col % 2 == 0:
                painter.drawText(QRectF(room.left() - 12, 0, room.width() + 24, line), middle, word)
        for row, cells in enumerate(self.cells):
            room = self._room(row, 0)
            at_left = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
            painter.setPen(text)
            painter.drawText(QRectF(0, room.top(), _LEFT_PX - 6, room.height()), at_left, self._rows[row])
            for col, cell in enumerate(cells):
                self._draw(painter, row, col, cell)

    def _draw(self, painter: QPainter, row: int, col: int, cell: BasinCell) -> None:
        room, colour = self._room(row, col), get_pose_colour(cell.pose_index)
        if cell.pose_index < 0:
            painter.setPen(self.palette().color(QPalette.ColorRole.Mid))
            painter.drawRect(room)
            return
        painter.fillRect(room, colour)
        painter.setPen(QColor(255, 255, 255) if colour.lightness() < 150 else QColor(20, 24, 30))
        words = f"{get_pose_letter(cell.pose_index)} {cell.rmse_mm:.2f}" if room.width() > _NARROW_PX + 10 else ""
        words = words or (get_pose_letter(cell.pose_index) if room.width() > 8 else "")
        painter.drawText(room, Qt.AlignmentFlag.AlignCenter, words)
        if (row, col) == self.selected_cell:
            painter.setPen(QPen(self.palette().color(QPalette.ColorRole.WindowText), 2.5))
            painter.drawRect(room.adjusted(1, 1, -1, -1))


def get_pose_letter(answer: int) -> str:
    """Return the letter of one of the first poses; a dot for the others."""
    return chr(ord("A") + answer) if 0 <= answer < len(CATEGORY_COLOURS) else "·"


def get_pose_colour(answer: int) -> QColor:
    """Return the colour of one of the first poses; grey for the others."""
    return to_qcolor(CATEGORY_COLOURS[answer] if 0 <= answer < len(CATEGORY_COLOURS) else _OTHER)


class BasinPanel(QWidget):
    """Start, axis of the starts and message over the map."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.run_bar, self.message, self.map = RunBar("basins", "Map basins"), QLabel(), BasinMap()
        self.axis_box = ChoiceBox("basins_along", "translation axis of the starts", {"x": "x", "y": "y"})
        self.run_bar.start_button.setToolTip("Register this touch from 216 starts around the pose and map the results")
        self.message.setWordWrap(True)
        head = set_spacing(QHBoxLayout(), 8)
        for widget in (self.run_bar, QLabel("translated along"), self.axis_box):
            head.addWidget(widget)
        head.addWidget(self.message, 1)
        layout = set_spacing(QVBoxLayout(self), 4, (6, 4, 6, 4))
        layout.addLayout(head)
        layout.addWidget(self.map, 1)
