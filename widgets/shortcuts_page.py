"""Help page of all commands and their shortcuts, with a search line."""

from collections.abc import Mapping, Sequence

from PyQt6.QtGui import QAction, QKeySequence
from PyQt6.QtWidgets import QDialog, QHeaderView, QTableWidget, QTableWidgetItem, QVBoxLayout, QWidget

from widgets.styling import fill, make_search_line, set_spacing
from widgets.table_copier import TableCopier, prepare_table

_SIZE_PX = 760, 560
_TITLES = ("menu", "command", "shortcut", "what it does")
_FORMAT = QKeySequence.SequenceFormat.NativeText


class ShortcutsPage(QDialog):
    """One row per command; the search line keeps the rows that hold all its words."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Commands and shortcuts")
        self.setObjectName("shortcuts")
        hint = "search: a command, a key, a word"
        self.line = make_search_line("shortcuts_search", "search of the commands", hint)
        self.table = QTableWidget(0, len(_TITLES))
        self.line.textChanged.connect(self._filter)
        columns = prepare_table(self.table, "shortcuts_table", "commands and shortcuts")
        self.table.setHorizontalHeaderLabels(_TITLES)
        self.table.setAlternatingRowColors(True)
        columns.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        columns.setStretchLastSection(True)
        fill(set_spacing(QVBoxLayout(self), 6, (8, 8, 8, 8)), self.line, self.table)
        TableCopier(self)

    def show_commands(self, menus: Mapping[str, Sequence[QAction]]) -> None:
        """Show the commands of each menu, on the screen whatever its size."""
        rows = [(menu, action) for menu, actions in menus.items() for action in actions if action.text()]
        self.table.setRowCount(len(rows))
        for at, (menu, action) in enumerate(rows):
            keys = ", ".join(key.toString(_FORMAT) for key in action.shortcuts())
            name = action.text().replace("&", "")
            tip = action.toolTip().removesuffix(f" ({action.shortcut().toString()})")
            for column, text in enumerate((menu, name, keys, tip)):
                self.table.setItem(at, column, QTableWidgetItem(text))
        self.line.clear()
        screen = self.screen()
        width_px, height_px = _SIZE_PX
        if screen is not None:
            room = screen.availableSize()
            width_px, height_px = min(width_px, room.width() - 40), min(height_px, room.height() - 80)
        self.resize(width_px, height_px)
        self.show()
        self.raise_()
        self.line.setFocus()

    def _filter(self, text: str) -> None:
        words = text.lower().split()
        for row in range(self.table.rowCount()):
            cells = [self.table.item(row, column) for column in range(len(_TITLES))]
            said = " ".join(cell.text() for cell in cells if cell is not None).lower()
            self.table.setRowHidden(row, not all(word in said for word in words))
