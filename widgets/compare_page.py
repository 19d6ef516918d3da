"""The page that shows one frame several ways: tabs with a row of controls, a sentence, and tiles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import (
    QComboBox,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from widgets.looks import spaced
from widgets.tiles import TileGrid

ORDERS = ("worst first", "best first", "in order")
ALL_SLOTS = "all slots"


class CompareTab(QWidget):
    """Controls and a bar over a sentence over tiles."""

    cancel_wanted = pyqtSignal()

    def __init__(self, controls: Sequence[QWidget], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.grid, self.told, self._bar, self._stop = TileGrid(), QLabel(), QProgressBar(), QPushButton("Cancel")
        self.controls = tuple(controls)
        self._bar.setRange(0, 1000)
        self._bar.setTextVisible(False)
        self._bar.setFixedWidth(140)
        self._stop.setObjectName("compare_cancel")
        self._stop.clicked.connect(self.cancel_wanted)
        self.told.setWordWrap(True)
        self.told.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Minimum)
        head = spaced(QHBoxLayout(), 6)
        for widget in self.controls:
            head.addWidget(widget)
        head.addWidget(self.told, 1)
        for widget in (self._bar, self._stop):
            room = widget.sizePolicy()
            room.setRetainSizeWhenHidden(True)
            widget.setSizePolicy(room)
            head.addWidget(widget)
        self.body = spaced(QHBoxLayout(), 6)
        self.body.addWidget(self.grid, 1)
        layout = spaced(QVBoxLayout(self), 4, (4, 4, 4, 2))
        layout.addLayout(head)
        layout.addLayout(self.body, 1)
        self.show_progress(None)

    def show_progress(self, fraction: float | None) -> None:
        """How far it is, None when it rests."""
        for widget in (self._bar, self._stop):
            widget.setVisible(fraction is not None)
        if fraction is not None:
            self._bar.setValue(round(1000 * fraction))


class ComparePage(QWidget):
    """Tabs by name; `tab_chosen` and `choice_changed` ask for what they show."""

    tab_chosen = pyqtSignal()
    choice_changed = pyqtSignal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.order = _box("compare_order", "order of the methods", ORDERS)
        self.order.activated.connect(self._changed)
        self.methods = CompareTab([QLabel("order"), self.order])
        self._names: Mapping[str, CompareTab] = {"methods": self.methods}
        self._tabs = QTabWidget()
        self._tabs.setDocumentMode(True)
        self._tabs.setObjectName("compare_tabs")
        self._tabs.addTab(self.methods, "Methods")
        layout = spaced(QVBoxLayout(self), 0)
        layout.addWidget(self._tabs)
        self._tabs.currentChanged.connect(self._turned)

    @property
    def tabs(self) -> Mapping[str, CompareTab]:
        """All of them by name."""
        return self._names

    @property
    def name(self) -> str:
        """Of the tab in front."""
        return next(name for name, tab in self._names.items() if tab is self._tabs.currentWidget())

    @property
    def tab(self) -> CompareTab:
        """The one in front."""
        return self._names[self.name]

    def _changed(self, *_: object) -> None:
        self.choice_changed.emit()

    def _turned(self, _: int) -> None:
        self.tab_chosen.emit()

    def show_tab(self, name: str) -> None:
        """Bring a tab to the front."""
        self._tabs.setCurrentWidget(self._names[name])


def _box(name: str, words: str, items: Sequence[str]) -> QComboBox:
    box = QComboBox()
    box.setObjectName(name)
    box.setAccessibleName(words)
    box.addItems(items)
    box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToContents)
    return box
