"""Table of stage times and the reason where a stage took no time."""

from __future__ import annotations

from dataclasses import dataclass

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QAbstractItemView, QHeaderView, QTableWidget, QTableWidgetItem, QWidget

from widgets.icons import make_state_icon

_HEADER = ("stage", "state", "time, ms", "notes")


@dataclass(frozen=True, slots=True, kw_only=True)
class TimingRow:
    """One stage of one frame."""

    title: str
    state: str
    time_ms: float
    notes: tuple[str, ...]


class TimingsPanel(QTableWidget):
    """One row per stage and one for the sum."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(0, len(_HEADER), parent)
        self.setObjectName("timings")
        self.setHorizontalHeaderLabels(_HEADER)
        self.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.setShowGrid(False)
        self.setWordWrap(False)
        rows, columns = self.verticalHeader(), self.horizontalHeader()
        assert rows is not None
        assert columns is not None
        rows.hide()
        rows.setDefaultSectionSize(self.fontMetrics().height() + 5)
        columns.setSectionResizeMode(QHeaderView.ResizeMode.Fixed)
        columns.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        for column, widest in enumerate(("Target depth and mask ", "    unchanged  ", "000000.00  ")):
            self.setColumnWidth(column, self.fontMetrics().horizontalAdvance(widest) + 16)
        columns.setStretchLastSection(True)

    def show_rows(self, timings: tuple[TimingRow, ...]) -> None:
        """Show these stages and their sum; only changed cells are updated."""
        self.setRowCount(len(timings) + 1)
        for at, row in enumerate(timings):
            self._cells(at, (row.title, row.state, f"{row.time_ms:.2f}", " · ".join(row.notes)), row.state)
        self._cells(len(timings), ("all stages", "", f"{sum(r.time_ms for r in timings):.2f}", ""), "")

    def _cells(self, at: int, texts: tuple[str, str, str, str], state: str) -> None:
        for column, text in enumerate(texts):
            item = self.item(at, column)
            if item is None:
                item = QTableWidgetItem()
                if column == 2:
                    item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
                self.setItem(at, column, item)
            if item.text() != text:
                item.setText(text)
                item.setToolTip(text)
                if column == 1 and state:
                    item.setData(Qt.ItemDataRole.DecorationRole, make_state_icon(state))
