"""Tables: their cells, filters by words and limits, their common look, and their copy as text."""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

from PyQt6.QtCore import (
    QAbstractItemModel,
    QEvent,
    QModelIndex,
    QObject,
    QPoint,
    QSortFilterProxyModel,
    Qt,
)
from PyQt6.QtGui import QKeyEvent, QKeySequence, QStandardItem, QStandardItemModel
from PyQt6.QtWidgets import QAbstractItemView, QHeaderView, QMenu, QTableView, QWidget

from widgets.style.styling import copy_text, make_line, name_widget

_Role = Qt.ItemDataRole
SORT_ROLE = Qt.ItemDataRole.UserRole  # a number, so that 10 comes after 9; unknown values come last
RIGHT = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
# title, tooltip and format of the numbers of each, "" for texts
Columns = Sequence[tuple[str, str, str]]
# of a row: the number that limits are of, words that hold or not, and texts that are searched
Terms = tuple[float, Mapping[str, bool], Iterable[str]]
_LIMIT = re.compile(r"([<>])=?(-?\d+(?:\.\d*)?|-?\.\d+)$")


def make_titled_model(columns: Columns, parent: QObject) -> QStandardItemModel:
    """Return an empty model with the titles and tooltips of these columns."""
    model = QStandardItemModel(0, len(columns), parent)
    for at, (title, tip, _) in enumerate(columns):
        model.setHeaderData(at, Qt.Orientation.Horizontal, title)
        model.setHeaderData(at, Qt.Orientation.Horizontal, tip, _Role.ToolTipRole)
    return model


def make_cells(
    columns: Columns, values: Sequence[str | float], tip: str, unknown: str = ""
) -> list[QStandardItem]:
    """Return the cells of a row with one tooltip.

    Numbers are sorted as such and stand at the right; NaN is written as `unknown`.
    """
    cells: list[QStandardItem] = []
    for (*_, form), value in zip(columns, values, strict=True):
        if isinstance(value, str):
            cell = QStandardItem(value)
            cell.setData(value, SORT_ROLE)
        else:
            cell = QStandardItem(format(value, form) if math.isfinite(value) else unknown)
            cell.setData(get_sort_key(value), SORT_ROLE)
            cell.setTextAlignment(RIGHT)
        cell.setToolTip(tip)
        cells.append(cell)
    return cells


def get_sort_key(number: float) -> float:
    """Return what a number is sorted by: unknown ones come last."""
    return number if math.isfinite(number) else -math.inf


class RowFilter(QSortFilterProxyModel):
    """Sorts by the table's sort role.

    Lists the rows of the source for which all terms of a filter hold.
    """

    def __init__(self, model: QAbstractItemModel, get_terms: Callable[[int], Terms]) -> None:
        """`get_terms(row)` returns what terms of a row can hold for."""
        super().__init__(model)
        self._words = tuple[str, ...]()
        self._get_terms = get_terms
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
            _holds(word, *self._get_terms(source_row)) for word in self._words
        )


def _holds(word: str, number: float, states: Mapping[str, bool], texts: Iterable[str]) -> bool:
    """Return whether a term holds: a limit, never of an unknown number, a state, or a word."""
    limit = _LIMIT.match(word)
    if limit is not None:
        bound = float(limit.group(2))
        return number > bound if limit.group(1) == ">" else -math.inf < number < bound
    return states[word] if word in states else any(word in text.lower() for text in texts)


class FilteredTable(QTableView):
    """Rows of one line, sorted by a click on a title; a line to type in filters them."""

    def __init__(
        self, name: str, model: QAbstractItemModel, get_terms: Callable[[int], Terms], tip: str
    ) -> None:
        """`name` is what the rows are; `tip` are the terms of the filter."""
        super().__init__()
        self.listed = RowFilter(model, get_terms)
        self.filter_line = make_line(f"{name}_filter", f"filter of the {name}", *tip.split("\n"))
        self.filter_line.setClearButtonEnabled(True)
        self.filter_line.textChanged.connect(self.listed.set_filter)
        self.columns = prepare_table(self, name, name)
        self.setModel(self.listed)
        self.columns.setMinimumSectionSize(30)

    def set_row_height(self, height_px: int) -> None:
        """Set the height of all rows."""
        rows = self.verticalHeader()
        assert rows is not None
        rows.setDefaultSectionSize(height_px)

    def sort_from(self, column: int) -> None:
        """Sort by a column until another is chosen."""
        self.columns.setSortIndicator(column, Qt.SortOrder.AscendingOrder)
        self.setSortingEnabled(True)

    def find_row(self, index: QModelIndex) -> int:
        """Return the row in the model of an index of the table."""
        return self.listed.mapToSource(index).row()

    def list_rows(self) -> list[int]:
        """Return the rows in the model that are listed, in their order."""
        return [self.find_row(self.listed.index(k, 0)) for k in range(self.listed.rowCount())]

    def select_row(self, row: int) -> None:
        """Select a row of the model; none where it is not listed."""
        model = self.listed.sourceModel()
        index = QModelIndex() if model is None else self.listed.mapFromSource(model.index(row, 0))
        if not index.isValid():
            self.clearSelection()
            return
        if index.row() not in {one.row() for one in self.selectedIndexes()}:
            self.setCurrentIndex(index)
        self.scrollTo(index)


def prepare_table(table: QTableView, name: str, description: str) -> QHeaderView:
    """Show rows of one line, selected as a whole and edited nowhere.

    Returns the header of the columns.
    """
    name_widget(table, name, description)
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
    chosen = set[int]()
    if only_selected and selection is not None:
        chosen = {index.row() for index in selection.selectedIndexes()}
    across = Qt.Orientation.Horizontal
    lines = [[model.headerData(column, across) for column in columns]]
    for row in sorted(chosen or range(model.rowCount())):
        lines.append([model.index(row, column).data() for column in columns])
    texts = [
        ["" if value is None else " ".join(str(value).split()) for value in line] for line in lines
    ]
    return "".join("\t".join(line) + "\n" for line in texts)


def _show_menu(table: QTableView, at: QPoint) -> None:
    menu = QMenu(table)
    viewport = table.viewport()
    action = menu.addAction("Copy table")
    if action is not None and viewport is not None:
        action.triggered.connect(lambda: copy_table(table))
        menu.popup(viewport.mapToGlobal(at))
