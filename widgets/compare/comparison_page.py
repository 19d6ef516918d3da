"""Comparison page: variants of one frame in three tabs (methods, two settings, a grid)."""

from collections.abc import Mapping
from typing import get_args

from PyQt6.QtCore import QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QLabel, QTabWidget, QWidget

from pipeline.lab.evaluation.method_comparison import SortOrder
from widgets.compare.comparison_tab import ComparisonTab, GridTab, TileTab
from widgets.style.base import ChoiceBox
from widgets.style.styling import make_column, make_command_button, name_widget

ALL_STAGES = "all stages"


class ComparisonPage(QWidget):
    """Tabs by name; `choice_changed` requests what the tab and its controls choose."""

    choice_changed = pyqtSignal()

    def __init__(self) -> None:
        super().__init__()
        orders = {order: order for order in get_args(SortOrder)}
        self.order_box = ChoiceBox("compare_order", "order of the methods", orders)
        self.stage_box = ChoiceBox("compare_stage", "compared stage")
        for changed in (self.order_box.chosen, self.stage_box.chosen):
            changed.connect(self._emit_choice)
        self.methods = TileTab([QLabel("order"), self.order_box])
        self.variants = TileTab([QLabel("stage"), self.stage_box])
        self.grid = GridTab()
        self.tabs: Mapping[str, ComparisonTab] = {
            "methods": self.methods,
            "two": self.variants,
            "grid": self.grid,
        }
        self._tab_bar = name_widget(QTabWidget(), "compare_tabs", "comparisons")
        self._n_commands = 0
        self._tab_bar.setDocumentMode(True)
        for tab, title in zip(self.tabs.values(), ("Methods", "Two settings", "Grid"), strict=True):
            self._tab_bar.addTab(tab, title)
        make_column(0, self._tab_bar, on=self)
        self._tab_bar.currentChanged.connect(self._emit_choice)

    @property
    def tile_tabs(self) -> tuple[TileTab, TileTab]:
        """The tabs that show tiles."""
        return self.methods, self.variants

    @property
    def current_name(self) -> str:
        """Name of the current tab."""
        return next(name for name, tab in self.tabs.items() if tab is self._tab_bar.currentWidget())

    @property
    def current_tab(self) -> ComparisonTab:
        """The current tab."""
        return self.tabs[self.current_name]

    def _emit_choice(self, _: object) -> None:
        self.choice_changed.emit()

    def add_command(self, action: QAction) -> None:
        """Add a button for a command to the tab of two settings."""
        button = make_command_button(action)
        button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.variants.head.insertWidget(2 + self._n_commands, button)
        self._n_commands += 1

    def show_choices(self, tab: str, order: str, stage: str) -> None:
        """Show the current choices, the last stage for one that is not offered; emits no signal."""
        index = self.stage_box.findData(stage)
        self.order_box.choose(order)
        self.stage_box.setCurrentIndex(index if index >= 0 else self.stage_box.count() - 1)
        with QSignalBlocker(self._tab_bar):
            self.show_tab(tab)

    def show_tab(self, name: str) -> None:
        """Bring a tab to the front."""
        self._tab_bar.setCurrentWidget(self.tabs[name])
