"""Tabs of commands of which one is checked."""

from collections.abc import Sequence

from PyQt6.QtCore import QSignalBlocker, Qt
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QTabBar


class ActionTabs(QTabBar):
    """One tab per checkable command: a tab runs its command, and a checked command selects its tab."""

    def __init__(self, actions: Sequence[QAction], name: str) -> None:
        super().__init__()
        self._actions = tuple(actions)
        self.setObjectName(f"{name}_tabs")
        self.setAccessibleName(name)
        self.setDrawBase(False)
        self.setExpanding(False)
        self.setUsesScrollButtons(True)
        self.setElideMode(Qt.TextElideMode.ElideNone)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)  # a click leaves the window its keys
        for action in self._actions:
            self.setTabToolTip(self.addTab(action.text()), action.toolTip())
            action.toggled.connect(self._select_checked)
        self.currentChanged.connect(self._run)
        self._select_checked()

    def _select_checked(self, _: bool = False) -> None:
        for i, action in enumerate(self._actions):
            if action.isChecked() and i != self.currentIndex():
                with QSignalBlocker(self):
                    self.setCurrentIndex(i)
                self.update()

    def _run(self, at: int) -> None:
        if 0 <= at < len(self._actions) and not self._actions[at].isChecked():
            self._actions[at].trigger()
