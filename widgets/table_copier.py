"""Tables: their common look, and their copy: Ctrl+C or the menu puts the selected rows, else all, on the clipboard."""

from functools import partial

from PyQt6.QtCore import QEvent, QObject, QPoint, Qt
from PyQt6.QtGui import QKeyEvent, QKeySequence
from PyQt6.QtWidgets import QAbstractItemView, QHeaderView, QMenu, QTableView, QWidget

from widgets.styling import copy_text

_Role = Qt.ItemDataRole


def prepare_table(table: QTableView, name: str, description: str) -> QHeaderView:
    """Show rows of one line, selected as a whole and edited nowhere; returns the header of the columns."""
    table.setObjectName(name)
    table.setAccessibleName(description)
    table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
    table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
    table.setShowGrid(False)
    table.setWordWrap(False)
    rows, columns = table.verticalHeader(), table.horizontalHeader()
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
        if isinstance(a1, QKeyEvent) and isinstance(a0, QTableView) and a1.matches(QKeySequence.StandardKey.Copy):
            a1.accept()
            if a1.type() == QEvent.Type.KeyPress:
                copy_table(a0, only_selected=True)
            return True
        return super().eventFilter(a0, a1)


def copy_table(table: QTableView, *, only_selected: bool = False) -> None:
    """Copy a table as text with tabs, as spreadsheets take it: titles, then the rows in the order on screen."""
    copy_text(format_table(table, only_selected=only_selected))


def format_table(table: QTableView, *, only_selected: bool = False) -> str:
    """Return the visible columns as text; the selected rows alone if asked for and there are any."""
    model, selection = table.model(), table.selectionModel()
    if model is None:
        return ""
    columns = [column for column in range(model.columnCount()) if not table.isColumnHidden(column)]
    rows = list(range(model.rowCount()))
    if only_selected and selection is not None and (chosen := {index.row() for index in selection.selectedIndexes()}):
        rows = sorted(chosen)
    titles = [model.headerData(column, Qt.Orientation.Horizontal, _Role.DisplayRole) for column in columns]
    lines = [titles, *([model.index(row, column).data(_Role.DisplayRole) for column in columns] for row in rows)]
    return "".join("\t".join(_to_cell(value) for value in line) + "\n" for line in lines)


def _to_cell(value: object) -> str:
    return "" if value is None else " ".join(str(value).split())


def _show_menu(table: QTableView, at: QPoint) -> None:
    menu, viewport = QMenu(table), table.viewport()
    action = menu.addAction("Copy table")
    if action is not None and viewport is not None:
        action.triggered.connect(lambda: copy_table(table))
        menu.popup(viewport.mapToGlobal(at))
