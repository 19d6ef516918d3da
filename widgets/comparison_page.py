"""Page that shows variants of one frame: tabs with controls, a message, and tiles."""

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

from widgets.spread_plot import SpreadPlot
from widgets.styling import make_command_button, set_spacing
from widgets.tile_grid import TileGrid
from widgets.view_3d_panel import View3DPanel

SORT_ORDERS = ("worst first", "best first", "in order")
ALL_STAGES = "all slots"
MAX_SEEDS = 64


class ComparisonTab(QWidget):
    """Controls and progress bar over a message over tiles."""

    cancel_requested = pyqtSignal()

    def __init__(self, controls: Sequence[QWidget], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.grid, self.message, self._bar, self._stop = TileGrid(), QLabel(), QProgressBar(), QPushButton("Cancel")
        self.controls = tuple(controls)
        self._bar.setRange(0, 1000)
        self._bar.setTextVisible(False)
        self._bar.setFixedWidth(140)
        self._stop.setObjectName("compare_cancel")
        self._stop.clicked.connect(self.cancel_requested)
        self.message.setWordWrap(True)
        self.message.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Minimum)
        self.head = head = set_spacing(QHBoxLayout(), 6)
        for widget in self.controls:
            head.addWidget(widget)
        head.addStretch(1)
        below = set_spacing(QHBoxLayout(), 6)
        below.addWidget(self.message, 1)
        for widget in (self._bar, self._stop):
            room = widget.sizePolicy()
            room.setRetainSizeWhenHidden(True)
            widget.setSizePolicy(room)
            below.addWidget(widget)
        self.body = set_spacing(QHBoxLayout(), 6)
        self.body.addWidget(self.grid, 1)
        self.stack = layout = set_spacing(QVBoxLayout(self), 4, (4, 4, 4, 2))
        layout.addLayout(head)
        layout.addLayout(below)
        layout.addLayout(self.body, 3)
        self.show_progress(None)

    def show_progress(self, fraction: float | None) -> None:
        """Show progress from 0 to 1; None hides the bar."""
        for widget in (self._bar, self._stop):
            widget.setVisible(fraction is not None)
        if fraction is not None:
            self._bar.setValue(round(1000 * fraction))


class ComparisonPage(QWidget):
    """Tabs by name; `tab_chosen` and `choice_changed` request their content."""

    tab_chosen = pyqtSignal()
    choice_changed = pyqtSignal()
    sampling_requested = pyqtSignal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.order_box = _box("compare_order", "order of the methods", SORT_ORDERS)
        self.order_box.activated.connect(self._changed)
        self.stage_box, self.seed_count_box, self.sample_button = QComboBox(), QSpinBox(), QPushButton("Draw")
        self.stage_box.setObjectName("compare_slot")
        self.stage_box.setAccessibleName("slot that is compared")
        self.stage_box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToContents)
        self.stage_box.activated.connect(self._changed)
        self.seed_count_box.setObjectName("compare_seeds")
        self.seed_count_box.setAccessibleName("how many seeds")
        self.seed_count_box.setRange(2, MAX_SEEDS)
        self.seed_count_box.setValue(8)
        self.seed_count_box.valueChanged.connect(self._changed)
        self.sample_button.setObjectName("compare_draw")
        self.sample_button.clicked.connect(self.sampling_requested)
        self.methods = ComparisonTab([QLabel("order"), self.order_box])
        self.variants, self.seeds = (
            ComparisonTab([QLabel("slot"), self.stage_box]),
            ComparisonTab([QLabel("seeds"), self.seed_count_box, self.sample_button]),
        )
        self.plot = SpreadPlot()
        self.plot.hide()
        self.seeds.body.addWidget(self.plot)
        self.views_3d, self._below = (View3DPanel(), View3DPanel()), QWidget()
        row = set_spacing(QHBoxLayout(self._below), 4)
        for cell in self.views_3d:
            row.addWidget(cell, 1)
        row.addStretch(1)  # under the difference, which has no 3D view
        row.setStretch(2, 1)
        self.variants.stack.addWidget(self._below, 2)
        self._below.hide()
        self._names: Mapping[str, ComparisonTab] = {"methods": self.methods, "two": self.variants, "seeds": self.seeds}
        self._tabs, self._commands = QTabWidget(), 0
        self._tabs.setDocumentMode(True)
        self._tabs.setObjectName("compare_tabs")
        for tab, title in ((self.methods, "Methods"), (self.variants, "Two at once"), (self.seeds, "Seeds")):
            self._tabs.addTab(tab, title)
        layout = set_spacing(QVBoxLayout(self), 0)
        layout.addWidget(self._tabs)
        self._tabs.currentChanged.connect(self._turned)

    @property
    def tabs(self) -> Mapping[str, ComparisonTab]:
        """All tabs by name."""
        return self._names

    @property
    def current_name(self) -> str:
        """Name of the current tab."""
        return next(name for name, tab in self._names.items() if tab is self._tabs.currentWidget())

    @property
    def current_tab(self) -> ComparisonTab:
        """The current tab."""
        return self._names[self.current_name]

    def _changed(self, *_: object) -> None:
        self.choice_changed.emit()

    def _turned(self, _: int) -> None:
        self.tab_chosen.emit()

    def add_command(self, action: QAction) -> None:
        """Add a button for a command to the tab of two variants."""
        button = make_command_button(action)
        button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.variants.head.insertWidget(2 + self._commands, button)
        self._commands += 1

    def offer_stages(self, stages: Mapping[str, str]) -> None:
        """Offer name -> title of stages to compare, all stages first; emits no signal."""
        names = ["", *stages]
        if [self.stage_box.itemData(i) for i in range(self.stage_box.count())] == names:
            return
        chosen = self.stage_box.currentData()
        with QSignalBlocker(self.stage_box):
            self.stage_box.clear()
            for name in names:
                self.stage_box.addItem(stages[name] if name else ALL_STAGES, name)
            self.stage_box.setCurrentIndex(names.index(chosen) if chosen in names else len(names) - 1)

    def show_choices(self, tab: str, order: str, stage: str, seeds: int) -> None:
        """Show what is chosen, the last slot for one that is not offered; says nothing to anybody."""
        at = self.stage_box.findData(stage)
        with (
            QSignalBlocker(self._tabs),
            QSignalBlocker(self.order_box),
            QSignalBlocker(self.stage_box),
            QSignalBlocker(self.seed_count_box),
        ):
            self._tabs.setCurrentWidget(self._names[tab])
            self.order_box.setCurrentText(order)
            self.stage_box.setCurrentIndex(at if at >= 0 else self.stage_box.count() - 1)
            self.seed_count_box.setValue(seeds)

    def show_3d_views(self, shown: bool) -> None:
        """Show or hide the 3D views under the two variants."""
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
