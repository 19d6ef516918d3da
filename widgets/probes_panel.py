"""Table of the pinned pixels: value and error of every stage there."""

from collections.abc import Sequence
from dataclasses import dataclass

from PyQt6.QtCore import QSignalBlocker, pyqtSignal
from PyQt6.QtGui import QColor, QIcon, QPixmap
from PyQt6.QtWidgets import (
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from widgets.styling import fill, set_spacing
from widgets.table_copier import prepare_table
from widgets.theme import get_probe_colour, to_qcolor

_HINT = "A click on an image pins a pixel, up to five; a click on its mark releases it."
_ICON_PX = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbeRow:
    """One pinned pixel."""

    number: int
    cells: tuple[str, ...]  # as the titles
    tips: tuple[str, ...]  # one per cell


class ProbesPanel(QWidget):
    """Shows one row per pinned pixel; `probe_chosen` carries the number of the selected row."""

    probe_chosen = pyqtSignal(int)

    def __init__(self) -> None:
        super().__init__()
        self.table, self.clear_button = QTableWidget(0, 0), QPushButton("Release all")
        columns = prepare_table(self.table, "probes", "pinned pixels")
        columns.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        self.table.cellClicked.connect(self._choose)
        self._numbers: tuple[int, ...] = ()
        self.clear_button.setEnabled(False)
        head = fill(set_spacing(QHBoxLayout(), 8), (QLabel(_HINT), 1), self.clear_button)
        fill(set_spacing(QVBoxLayout(self), 3, (6, 3, 6, 2)), head, (self.table, 1))

    def _choose(self, row: int, _: int) -> None:
        self.probe_chosen.emit(self._numbers[row])

    def show_probes(self, titles: Sequence[str], rows: Sequence[ProbeRow]) -> None:
        """Show these pinned pixels under these titles."""
        self._numbers = tuple(row.number for row in rows)
        self.clear_button.setEnabled(bool(rows))
        with QSignalBlocker(self.table):
            self.table.setColumnCount(len(titles))
            self.table.setHorizontalHeaderLabels(titles)
            self.table.setRowCount(len(rows))
            for at, row in enumerate(rows):
                for column, (text, tip) in enumerate(zip(row.cells, row.tips, strict=True)):
                    item = QTableWidgetItem(text)
                    item.setToolTip(tip)
                    if column == 0:
                        item.setIcon(_make_icon(row.number))
                    self.table.setItem(at, column, item)


def _make_icon(number: int) -> QIcon:
    pixmap = QPixmap(_ICON_PX, _ICON_PX)
    pixmap.fill(QColor(to_qcolor(get_probe_colour(number))))
    return QIcon(pixmap)
