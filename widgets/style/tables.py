"""Tables: models of rows, filters by words and limits, their common look, and their copy as
text.
"""

import math
import re
from collections.abc import Callable, Sequence
from functools import partial

from PyQt6.QtCore import (
    QAbstractTableModel,
    QEvent,
    QModelIndex,
    QObject,
    QPoint,
    QSortFilterProxyModel,
    Qt,
)
from PyQt6.QtGui import QKeyEvent, QKeySequence
from PyQt6.QtWidgets import QAbstractItemView, QHeaderView, QMenu, QTableView, QWidget

from widgets.style.styling import copy_text

_Role = Qt.ItemDataRole
SORT_ROLE = Qt.ItemDataRole.UserRole  # a number, so that 10 comes after 9; unknown values come last
_RIGHT = int(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
_LIMIT = re.compile(r"([<>])=?(-?\d+(?:\.\d*)?|-?\.\d+)$")


class RowsModel(QAbstractTableModel):
    """One row per thing under titled columns.

    Subclasses set `n_rows` and say of a cell its text, its number, its picture and its tooltip.
    """

    def __init__(self, titles: Sequence[str], tips: Sequence[str], parent: QObject) -> None:
        super().__init__(parent)
        self.n_rows = 0
        self._headings: dict[int, list[str]] = {
            _Role.DisplayRole: list(titles),
            _Role.ToolTipRole: list(tips),
        }

    def rowCount(self, parent: QModelIndex = QModelIndex()) -> int:  # noqa: N802, B008 - Qt's own default
        """Return the number of rows."""
        return 0 if parent.isValid() else self.n_rows

    def columnCount(self, parent: QModelIndex = QModelIndex()) -> int:  # noqa: N802, B008 - Qt's own default
        """Return the number of columns."""
        return 0 if parent.isValid() else len(self._headings[_Role.DisplayRole])

    def format_cell(self, row: int, column: int) -> str:
        """Return the text of a cell."""
        raise NotImplementedError

    def get_number(self, row: int, column: int) -> float | None:  # noqa: ARG002
        """Return the number of a cell, NaN if unknown; None for a column of texts."""
        return None

    def get_picture(self, row: int, column: int) -> object:  # noqa: ARG002
        """Return the icon of a cell; None without one."""
        return None

    def get_tip(self, row: int, column: int) -> str:
        """Return the tooltip of a cell."""
        return self.format_cell(row, column)

    def data(self, index: QModelIndex, role: int = _Role.DisplayRole) -> object:
        """Return what Qt asks of a cell; numbers are sorted as such and stand at the right."""
        if not index.isValid():
            return None
        cell = index.row(), index.column()
        number = self.get_number(*cell)
        if role == SORT_ROLE and number is not None:
            return number if math.isfinite(number) else -math.inf
        if role == _Role.TextAlignmentRole:
            return None if number is None else _RIGHT
        reads = {
            _Role.DisplayRole: self.format_cell,
            SORT_ROLE: self.format_cell,
            _Role.DecorationRole: self.get_picture,
            _Role.ToolTipRole: self.get_tip,
        }
        return reads[_Role(role)](*cell) if role in reads else None

    def headerData(  # noqa: N802 - Qt's name
        self, section: int, orientation: Qt.Orientation, role: int = _Role.DisplayRole
    ) -> object:
        """Return title or tooltip of a column."""
        is_column = orientation == Qt.Orientation.Horizontal and 0 <= section < self.columnCount()
        return self._headings[role][section] if is_column and role in self._headings else None


class RowFilter(QSortFilterProxyModel):
    """Sorts by the table's sort role.

    Lists the rows of the source for which all terms of a filter hold.
    """

    def __init__(self, model: QAbstractTableModel, matches: Callable[[int, str], bool]) -> None:
        """`matches(row, term)` returns whether a term holds."""
        super().__init__(model)
        self._words = tuple[str, ...]()
        self._matches = matches
        self.setSourceModel(model)
        self.setSortRole(SORT_ROLE)

    def set_filter(self, words: str) -> None:
        """List the rows for which all terms hold; all rows for no term."""
        wanted = tuple(words.lower().split())
        if wanted != self._words:
            self._words = wanted
            self.invalidateFilter()

    def filterAcceptsRow(self, source_row: int, source_parent: QModelIndex) -> bool:  # noqa: N802
        """Return whether a row is listed."""
        return not source_parent.isValid() and all(
            self._matches(source_row, word) for word in self._words
        )


def matches_limit(word: str, value: float) -> bool | None:
    """Return whether a value is beyond the limit that a term is, never if it is unknown.

    None for another term.
    """
    limit = _LIMIT.match(word)
    if limit is None:
        return None
    bound = float(limit.group(2))
    return value > bound if limit.group(1) == ">" else -math.inf < value < bound


def prepare_table(table: QTableView, name: str, description: str) -> QHeaderView:
    """Show rows of one line, selected as a whole and edited nowhere.

    Returns the header of the columns.
    """
    table.setObjectName(name)
    table.setAccessibleName(description)
    table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
    table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
    table.setShowGrid(False)
    table.setWordWrap(False)
    rows = table.verticalHeader()
    columns = table.horizontalHeader()
    assert rows is not None
    assert columns is not None
    rows.hide()
    rows.setDefaultSectionSize(table.fontMetrics().height() + 5)
    columns.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
    return columns


class TableCopier(QObject):
    """Watches every table of a window; tables that are added later need `watch_tables` again."""

    def __init__(self, window: QWidget) -> None:
        super().__init__(window)
        self.watch_tables(window)

    def watch_tables(self, part: QWidget) -> None:
        """Let every table in `part` be copied."""
        for table in part.findChildren(QTableView):
            table.installEventFilter(self)
            table.setContextMenuPolicy(Qt.ContextMenuPolicy.CustomContextMenu)
            table.customContextMenuRequested.connect(partial(_show_menu, table))

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """Take Ctrl+C from the window while a table has the focus."""
        if (
            isinstance(a1, QKeyEvent)
            and isinstance(a0, QTableView)
            and a1.matches(QKeySequence.StandardKey.Copy)
        ):
            a1.accept()
            if a1.type() == QEvent.Type.KeyPress:
                copy_table(a0, only_selected=True)
            return True
        return super().eventFilter(a0, a1)


def copy_table(table: QTableView, *, only_selected: bool = False) -> None:
    """Copy a table as text with tabs, as spreadsheets take it: titles, then the rows in the
    order on screen.
    """
    copy_text(format_table(table, only_selected=only_selected))


def format_table(table: QTableView, *, only_selected: bool = False) -> str:
    """Return the visible columns as text.

    The selected rows alone if asked for and there are any.
    """
    model = table.model()
    selection = table.selectionModel()
    if model is None:
        return ""
    columns = [column for column in range(model.columnCount()) if not table.isColumnHidden(column)]
    rows = list(range(model.rowCount()))
    if (
        only_selected
        and selection is not None
        and (chosen := {index.row() for index in selection.selectedIndexes()})
    ):
        rows = sorted(chosen)
    titles = [
        model.headerData(column, Qt.Orientation.Horizontal, _Role.DisplayRole) for column in columns
    ]
    lines = [
        titles,
        *([model.index(row, column).data(_Role.DisplayRole) for column in columns] for row in rows),
    ]
    return "".join(
        "\t".join(("" if value is None else " ".join(str(value).split())) for value in line) + "\n"
        for line in lines
    )


def _show_menu(table: QTableView, at: QPoint) -> None:
    menu = QMenu(table)
    viewport = table.viewport()
    action = menu.addAction("Copy table")
    if action is not None and viewport is not None:
        action.triggered.connect(lambda: copy_table(table))
        menu.popup(viewport.mapToGlobal(at))
