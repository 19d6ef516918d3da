"""Map of where a registration ends for a grid of starts: one colour and letter per pose; a click shows that pose."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from PyQt6.QtCore import Qt
from PyQt6.QtGui import QColor, QPainter, QPalette, QPen
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QVBoxLayout, QWidget

from widgets.base import ChoiceBox, resize_font
from widgets.cell_grid import NO_CELL, CellGrid, CellIndex
from widgets.run_bar import StartBar
from widgets.styling import fill, set_spacing
from widgets.theme import CATEGORY_COLOURS, ThemeColours, to_qcolor

_OTHER = (170, 174, 182)  # colour of poses without a colour of their own
_NARROW_PX = 26.0  # narrower cells have no number


@dataclass(frozen=True, slots=True, kw_only=True)
class BasinCell:
    """One start: the index of the pose it ended in (-1 = none), and how well that fits."""

    pose_index: int
    rmse_mm: float
    tooltip: str


class BasinMap(CellGrid):
    """Rows are translations, columns rotations; the start at the centre is the pose itself."""

    preferred_px = 640, 170

    def __init__(self) -> None:
        super().__init__("basin_map", "result of the registration from each start; arrow keys select one")
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        resize_font(self)
        self.cells: dict[CellIndex, BasinCell] = {}
        self.cell_chosen.connect(self.mark_used_cell)

    def show_map(
        self, cells: Mapping[CellIndex, BasinCell], across: tuple[str, Sequence[str]], down: tuple[str, Sequence[str]]
    ) -> None:
        """Show these cells, with names and values of columns and rows; clear the map for no cells."""
        self.cells = dict(cells)
        self.show_axes(across, down)
        for index, cell in cells.items():
            self.add_cell(index, cell.tooltip, can_choose=cell.pose_index >= 0)

    def keyPressEvent(self, a0: Any) -> None:  # noqa: N802
        """Move the selection with the arrow keys."""
        steps = {Qt.Key.Key_Left: (0, -1), Qt.Key.Key_Right: (0, 1), Qt.Key.Key_Up: (-1, 0), Qt.Key.Key_Down: (1, 0)}
        if a0.key() not in steps or not self.cells:
            super().keyPressEvent(a0)
            return
        down, right = steps[a0.key()]
        row, col = (len(self.rows) // 2, len(self.columns) // 2) if self.used_cell == NO_CELL else self.used_cell
        self.choose_cell(min(max(row + down, 0), len(self.rows) - 1), (col + right) % len(self.columns))

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint the cells in the colours of their poses, with letter and rmse."""
        del ink
        if self.cells:
            self.draw_names(painter)
        for index, cell in self.cells.items():
            self._draw(painter, index, cell)

    def _draw(self, painter: QPainter, index: CellIndex, cell: BasinCell) -> None:
        room, colour = self.get_room(*index), get_pose_colour(cell.pose_index)
        if cell.pose_index < 0:
            painter.setPen(self.palette().color(QPalette.ColorRole.Mid))
            painter.drawRect(room)
            return
        painter.fillRect(room, colour)
        painter.setPen(QColor(255, 255, 255) if colour.lightness() < 150 else QColor(20, 24, 30))
        words = f"{get_pose_letter(cell.pose_index)} {cell.rmse_mm:.2f}" if room.width() > _NARROW_PX + 10 else ""
        words = words or (get_pose_letter(cell.pose_index) if room.width() > 8 else "")
        painter.drawText(room, Qt.AlignmentFlag.AlignCenter, words)
        if index == self.used_cell:
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

    def __init__(self) -> None:
        super().__init__()
        self.run_bar, self.message, self.map = StartBar("basins", "Map basins"), QLabel(), BasinMap()
        self.axis_box = ChoiceBox("basins_along", "translation axis of the starts", {"x": "x", "y": "y"})
        self.run_bar.start_button.setToolTip("Register this touch from 216 starts around the pose and map the results")
        self.message.setWordWrap(True)
        head = set_spacing(QHBoxLayout(), 8)
        fill(head, self.run_bar, QLabel("translated along"), self.axis_box, (self.message, 1))
        fill(set_spacing(QVBoxLayout(self), 4, (6, 4, 6, 4)), head, (self.map, 1))
