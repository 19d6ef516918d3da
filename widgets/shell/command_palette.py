"""Every command of the window: a palette that finds them by a few letters, and the page of their
shortcuts.
"""

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import QEvent, QObject, Qt
from PyQt6.QtGui import QAction, QKeyEvent, QKeySequence
from PyQt6.QtWidgets import (
    QDialog,
    QHeaderView,
    QLabel,
    QLineEdit,
    QListWidget,
    QListWidgetItem,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from widgets.style.styling import fill, make_search_line, set_spacing
from widgets.style.tables import TableCopier, prepare_table

_WIDTH_PX = 560
_MOST_SHOWN = 200
_KEYS = (Qt.Key.Key_Up, Qt.Key.Key_Down, Qt.Key.Key_PageUp, Qt.Key.Key_PageDown)
_SIZE_PX = 760, 560
_TITLES = ("menu", "command", "shortcut", "what it does")
_FORMAT = QKeySequence.SequenceFormat.NativeText


class CommandPalette(QDialog):
    """Type to filter, select with the arrows, Enter runs, Esc closes."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Commands")
        self.setObjectName("palette")
        self._actions: Sequence[QAction] = ()
        self.line = QLineEdit()
        self.results = QListWidget()
        self._tip = QLabel()
        self.line.setPlaceholderText("type a few letters of a command")
        self.line.setAccessibleName("command")
        self.results.setObjectName("palette_found")
        self.results.setAccessibleName("commands that match")
        self._tip.setWordWrap(True)
        layout = set_spacing(QVBoxLayout(self), 4, (8, 8, 8, 8))
        for widget in (self.line, self.results, self._tip):
            layout.addWidget(widget)
        self.resize(_WIDTH_PX, 380)
        self.line.installEventFilter(self)
        self.line.textChanged.connect(self._filter)
        self.line.returnPressed.connect(self.run_selected)
        self.results.itemActivated.connect(self.run_selected)
        self.results.currentItemChanged.connect(self._tell)

    def show_commands(self, actions: Sequence[QAction]) -> None:
        """List these commands, enabled ones first."""
        self._actions = sorted(actions, key=lambda action: not action.isEnabled())
        self.line.clear()
        self._filter()
        self.show()
        self.raise_()
        self.line.setFocus()

    def run_selected(self) -> None:
        """Run the selected command."""
        item = self.results.currentItem()
        action: QAction | None = None if item is None else item.data(Qt.ItemDataRole.UserRole)
        if action is not None and action.isEnabled():
            self.accept()
            action.trigger()

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """Move through the list with the arrow keys while typing."""
        if isinstance(a1, QKeyEvent) and a1.type() == QEvent.Type.KeyPress and a1.key() in _KEYS:
            self.results.keyPressEvent(a1)
            return True
        return super().eventFilter(a0, a1)

    def _filter(self) -> None:
        text = self.line.text()
        ranked = sorted(
            (
                (score, i)
                for i, action in enumerate(self._actions)
                if (score := _score(text, get_command_name(action))) >= 0
            ),
        )
        self.results.clear()
        for _, i in ranked[:_MOST_SHOWN]:
            action = self._actions[i]
            key = action.shortcut().toString()
            item = QListWidgetItem(
                f"{get_command_name(action)}    {key}" if key else get_command_name(action)
            )
            item.setIcon(action.icon())
            item.setData(Qt.ItemDataRole.UserRole, action)
            if not action.isEnabled():
                item.setFlags(item.flags() & ~Qt.ItemFlag.ItemIsEnabled)
            self.results.addItem(item)
        self.results.setCurrentRow(0)

    def _tell(self) -> None:
        item = self.results.currentItem()
        self._tip.setText("" if item is None else item.data(Qt.ItemDataRole.UserRole).toolTip())


def get_command_name(action: QAction) -> str:
    """Return the name of a command."""
    return action.text().replace("&", "")


def _score(text: str, name: str) -> int:
    """Return how far apart the letters of `text` lie in `name`, in order; -1 if one is missing."""
    at = -1
    score = 0
    low = name.lower()
    if text.lower() in low:
        return low.index(text.lower())
    for letter in text.lower().replace(" ", ""):
        found = low.find(letter, at + 1)
        if found < 0:
            return -1
        score += found - at
        at = found
    return score + len(name)


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
        rows = [
            (menu, action) for menu, actions in menus.items() for action in actions if action.text()
        ]
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
            width_px = min(width_px, room.width() - 40)
            height_px = min(height_px, room.height() - 80)
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
