"""Welcome page of an empty window: sample, recent files, and a drop area."""

from collections.abc import Sequence
from pathlib import Path

from PyQt6.QtCore import QEvent, QPoint, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import (
    QHBoxLayout,
    QLabel,
    QListWidget,
    QListWidgetItem,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from pipeline.core.errors import escape_text
from widgets.style.base import EventListener, enlarge_font
from widgets.style.styling import fill, make_bold, make_column, make_row, name_widget

_WIDTH_PX = 620
_ROW_PX = 24
_DASHED = "#drop { border: 2px dashed palette(placeholder-text); border-radius: 6px }"
_PURPOSE = (
    "Translate the touch of one tactile sensor into another's: every stage side by side, compared "
    "with the truth "
    "where it is recorded."
)


class WelcomePage(QWidget):
    """Covers `first` and everything below it until a recording is open.

    `recent_chosen` carries a file.
    """

    recent_chosen = pyqtSignal(object)  # Path

    def __init__(
        self, over: QWidget, first: QWidget, commands: Sequence[QAction], formats: str
    ) -> None:
        """`formats` are the names of what can be opened."""
        super().__init__(over)
        self._first = first
        name_widget(self, "welcome")
        self.setAutoFillBackground(True)
        title = make_bold(QLabel("Tactoscope"))
        purpose = QLabel(_PURPOSE)
        drop = QLabel("Drop a recording here, or a folder of recordings")
        name_widget(drop, "drop", tip=formats).setStyleSheet(_DASHED)
        enlarge_font(title, 9.0)
        purpose.setWordWrap(True)
        drop.setAlignment(Qt.AlignmentFlag.AlignCenter)
        drop.setMinimumHeight(72)
        drop.setMargin(10)
        self.buttons = [_button(command) for command in commands]
        self._told = make_bold(QLabel("Recent"))
        self.recent = name_widget(QListWidget(), "recent", "recent recordings")
        for chosen in (self.recent.itemActivated, self.recent.itemClicked):
            chosen.connect(self._open_recent)
        self._sheet = QWidget()
        self._sheet.setMaximumWidth(_WIDTH_PX)
        row = make_row(8, *self.buttons, 1)
        make_column(12, title, purpose, row, drop, self._told, self.recent, on=self._sheet)
        fill(QHBoxLayout(self), 1, (fill(QVBoxLayout(), 1, self._sheet, 2), 10), 1)
        for widget in (over, first):
            EventListener(widget, self._cover, QEvent.Type.Resize, QEvent.Type.Move)
        self._cover()

    def show_recent(self, paths: Sequence[Path]) -> None:
        """Show recent files, the latest first."""
        self.recent.clear()
        for path in paths:
            item = QListWidgetItem(f"{escape_text(path.name)}    {escape_text(str(path.parent))}")
            item.setData(Qt.ItemDataRole.UserRole, path)
            item.setToolTip(escape_text(str(path)))
            item.setSizeHint(QSize(10, _ROW_PX))
            self.recent.addItem(item)
        for widget in (self._told, self.recent):
            widget.setVisible(bool(paths))
        self.recent.setFixedHeight(min(len(paths), 8) * _ROW_PX + 6)

    def _cover(self) -> None:
        over = self.parentWidget()
        if over is not None:
            top = self._first.mapTo(over, QPoint(0, 0)).y()
            self.setGeometry(0, top, over.width(), over.height() - top)
            self.raise_()

    def _open_recent(self, item: QListWidgetItem) -> None:
        self.recent_chosen.emit(item.data(Qt.ItemDataRole.UserRole))


def _button(command: QAction) -> QToolButton:
    button = QToolButton()
    button.setDefaultAction(command)
    button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
    button.setIconSize(QSize(20, 20))
    button.setMinimumHeight(34)
    button.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
    return button
