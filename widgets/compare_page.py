"""The page that shows one frame several ways: tabs with a row of controls, a sentence, and tiles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import (
    QComboBox,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QSpinBox,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from widgets.looks import command_button, spaced
from widgets.solid_cell import SolidCell
from widgets.spread_plot import SpreadPlot
from widgets.tiles import TileGrid

ORDERS = ("worst first", "best first", "in order")
ALL_SLOTS = "all slots"
MOST_SEEDS = 64


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
        self.head = head = spaced(QHBoxLayout(), 6)
        for widget in self.controls:
            head.addWidget(widget)
        head.addStretch(1)
        below = spaced(QHBoxLayout(), 6)
        below.addWidget(self.told, 1)
        for widget in (self._bar, self._stop):
            room = widget.sizePolicy()
            room.setRetainSizeWhenHidden(True)
            widget.setSizePolicy(room)
            below.addWidget(widget)
        self.body = spaced(QHBoxLayout(), 6)
        self.body.addWidget(self.grid, 1)
        self.stack = layout = spaced(QVBoxLayout(self), 4, (4, 4, 4, 2))
        layout.addLayout(head)
        layout.addLayout(below)
        layout.addLayout(self.body, 3)
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
    draw_wanted = pyqtSignal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.order = _box("compare_order", "order of the methods", ORDERS)
        self.order.activated.connect(self._changed)
        self.slot, self.count, self.draw = QComboBox(), QSpinBox(), QPushButton("Draw")
        self.slot.setObjectName("compare_slot")
        self.slot.setAccessibleName("slot that is compared")
        self.slot.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToContents)
        self.slot.activated.connect(self._changed)
        self.count.setObjectName("compare_seeds")
        self.count.setAccessibleName("how many seeds")
        self.count.setRange(2, MOST_SEEDS)
        self.count.setValue(8)
        self.count.valueChanged.connect(self._changed)
        self.draw.setObjectName("compare_draw")
        self.draw.clicked.connect(self.draw_wanted)
        self.methods = CompareTab([QLabel("order"), self.order])
        self.two, self.seeds = (
            CompareTab([QLabel("slot"), self.slot]),
            CompareTab([QLabel("seeds"), self.count, self.draw]),
        )
        self.plot = SpreadPlot()
        self.plot.hide()
        self.seeds.body.addWidget(self.plot)
        self.solids, self._below = (SolidCell(), SolidCell()), QWidget()
        row = spaced(QHBoxLayout(self._below), 4)
        for cell in self.solids:
            row.addWidget(cell, 1)
        row.addStretch(1)  # under the difference, which has no 3D
        row.setStretch(2, 1)
        self.two.stack.addWidget(self._below, 2)
        self._below.hide()
        self._names: Mapping[str, CompareTab] = {"methods": self.methods, "two": self.two, "seeds": self.seeds}
        self._tabs, self._commands = QTabWidget(), 0
        self._tabs.setDocumentMode(True)
        self._tabs.setObjectName("compare_tabs")
        for tab, title in ((self.methods, "Methods"), (self.two, "Two at once"), (self.seeds, "Seeds")):
            self._tabs.addTab(tab, title)
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

    def add_command(self, action: QAction) -> None:
        """Give a command of the tab with two a button."""
        button = command_button(action)
        button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.two.head.insertWidget(2 + self._commands, button)
        self._commands += 1

    def offer_slots(self, slots: Mapping[str, str]) -> None:
        """Name -> title of the slots that can be compared, all of them first; says nothing to anybody."""
        names = ["", *slots]
        if [self.slot.itemData(i) for i in range(self.slot.count())] == names:
            return
        chosen = self.slot.currentData()
        with QSignalBlocker(self.slot):
            self.slot.clear()
            for name in names:
                self.slot.addItem(slots[name] if name else ALL_SLOTS, name)
            self.slot.setCurrentIndex(names.index(chosen) if chosen in names else len(names) - 1)

    def show_choices(self, tab: str, order: str, slot: str, seeds: int) -> None:
        """Show what is chosen, the last slot for one that is not offered; says nothing to anybody."""
        at = self.slot.findData(slot)
        with (
            QSignalBlocker(self._tabs),
            QSignalBlocker(self.order),
            QSignalBlocker(self.slot),
            QSignalBlocker(self.count),
        ):
            self._tabs.setCurrentWidget(self._names[tab])
            self.order.setCurrentText(order)
            self.slot.setCurrentIndex(at if at >= 0 else self.slot.count() - 1)
            self.count.setValue(seeds)

    def show_solids(self, shown: bool) -> None:
        """Whether the two have 3D views under them."""
        self._below.setVisible(shown)

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
