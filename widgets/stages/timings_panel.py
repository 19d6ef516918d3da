"""The Timings tab: what every stage of the frame on screen cost."""

from dataclasses import dataclass

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QHeaderView, QTableWidget, QTableWidgetItem, QVBoxLayout, QWidget

from widgets.style.icons import make_state_icon
from widgets.style.styling import fill, set_spacing
from widgets.style.tables import prepare_table

_HEADER = ("stage", "state", "time, ms", "share", "notes")
# columns
_STATE = 1
_NUMBERS = (2, 3)


@dataclass(frozen=True, slots=True, kw_only=True)
class TimingRow:
    """One stage of one frame."""

    title: str
    state: str
    time_ms: float
    notes: tuple[str, ...] = ()


class TimingsPanel(QWidget):
    """Table of the stages and their sum."""

    def __init__(self) -> None:
        super().__init__()
        self.table = QTableWidget(0, len(_HEADER))
        columns = prepare_table(self.table, "timings", "times of the stages")
        self.table.setHorizontalHeaderLabels(_HEADER)
        columns.setSectionResizeMode(QHeaderView.ResizeMode.Fixed)
        for column, widest in enumerate(
            ("  Target depth and mask ", "    unchanged  ", "time, ms  ", "100 %  ")
        ):
            self.table.setColumnWidth(
                column, self.table.fontMetrics().horizontalAdvance(widest) + 16
            )
        columns.setStretchLastSection(True)
        fill(set_spacing(QVBoxLayout(self), 3, (6, 3, 6, 2)), (self.table, 1))

    def show_rows(self, timings: tuple[TimingRow, ...]) -> None:
        """Show these stages and their sum; only changed cells are updated."""
        total_ms = sum(row.time_ms for row in timings)
        rows = (*timings, TimingRow(title="all stages", state="", time_ms=total_ms))
        self.table.setRowCount(len(rows))
        for at, row in enumerate(rows):
            share = f"{100 * row.time_ms / total_ms:.0f} %" if total_ms > 0 else ""
            texts = (row.title, row.state, f"{row.time_ms:.2f}", share, " · ".join(row.notes))
            for column, text in enumerate(texts):
                self._show_cell(at, column, text)

    def _show_cell(self, at: int, column: int, text: str) -> None:
        item = self.table.item(at, column)
        if item is None:
            item = QTableWidgetItem()
            if column in _NUMBERS:
                item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
            self.table.setItem(at, column, item)
        if item.text() != text:
            item.setText(text)
            item.setToolTip(text)
            if column == _STATE:
                item.setData(
                    Qt.ItemDataRole.DecorationRole, make_state_icon(text) if text else None
                )
