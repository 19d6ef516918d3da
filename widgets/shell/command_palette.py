"""Every command of the window, with its shortcut, found by a few letters or words."""

from collections.abc import Sequence

from PyQt6.QtCore import QEvent, QObject, Qt
from PyQt6.QtGui import QAction, QKeyEvent
from PyQt6.QtWidgets import (
    QDialog,
    QListWidget,
    QListWidgetItem,
    QWidget,
)

from widgets.style.styling import make_column, make_line, make_text, name_widget

_WIDTH_PX = 560
_KEYS = (Qt.Key.Key_Up, Qt.Key.Key_Down, Qt.Key.Key_PageUp, Qt.Key.Key_PageDown)
_FAR = 10_000  # rank of a command that is found by its description, after those by name


class CommandPalette(QDialog):
    """Type to filter, select with the arrows, Enter runs, Esc closes."""

    def __init__(self, parent: QWidget | None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Commands")
        name_widget(self, "palette")
        self._actions: Sequence[QAction] = ()
        placeholder = "a few letters of a command, its key, or a word of what it does"
        self.line = make_line("", "command", placeholder)
        self.results = name_widget(QListWidget(), "palette_found", "commands that match")
        self._tip = make_text()
        make_column(4, self.line, self.results, self._tip, around_px=(8, 8, 8, 8), on=self)
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
        ranks = {action: _rank(text, action) for action in self._actions}
        self.results.clear()
        for action in sorted(ranks, key=ranks.__getitem__):
            if ranks[action] < 0:
                continue
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


def _rank(text: str, action: QAction) -> int:
    """Return the place of a command among those that match: by name, else by the words of its
    tooltip, which ends in its key; -1 if it does not.
    """
    text = text.lower()
    score = _score(text, get_command_name(action).lower())
    tip = action.toolTip().lower()
    return _FAR if score < 0 and all(word in tip for word in text.split()) else score


def _score(text: str, name: str) -> int:
    """Return how far apart the letters of `text` lie in `name`, in order; -1 if one is missing."""
    if text in name:
        return name.index(text)
    at = -1
    for letter in text.replace(" ", ""):
        at = name.find(letter, at + 1)
        if at < 0:
            return -1
    return at + 1 + len(name)
