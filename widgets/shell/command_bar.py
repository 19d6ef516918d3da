"""Bars of commands: a tool bar whose buttons show their text where there is room, and tabs of
which one is checked.
"""

from collections.abc import Sequence
from typing import Any

from PyQt6.QtCore import QEvent, QSignalBlocker, QSize, Qt
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QTabBar, QToolBar, QToolButton, QWidget

from widgets.style.base import EventListener
from widgets.style.styling import make_single_shot_timer, name_widget

_Style = Qt.ToolButtonStyle
_SPARE_PX = 12  # left free at the right end


class CommandBar(QToolBar):
    """Icons, with the commands' names next to as many of them as fit.

    The tab key reaches every button.
    """

    def __init__(self, title: str, parent: QWidget) -> None:
        super().__init__(title, parent)
        name_extension(self)
        self._ordered: tuple[QToolButton, ...] = ()
        self._fit_soon = make_single_shot_timer(self, 0, self.fit_texts)

    def set_text_order(self, actions: Sequence[QAction]) -> None:
        """Set which commands get their text, the most important first."""
        buttons = [self.widgetForAction(action) for action in actions]
        self._ordered = tuple(button for button in buttons if isinstance(button, QToolButton))
        for item in map(self.widgetForAction, self.actions()):
            if item is not None and item not in self._ordered:  # a tab or a name takes their room
                EventListener(item, self._fit_soon.start, QEvent.Type.Resize)
        self._fit_soon.start()

    def fit_texts(self) -> None:
        """Show the text of as many buttons as fit into the width."""
        layout = self.layout()
        if layout is None:
            return
        spacing = layout.spacing()
        around = layout.contentsMargins()
        items = [self.widgetForAction(action) for action in self.actions() if action.isVisible()]
        used = around.left() + around.right() + _SPARE_PX
        for button in self._ordered:
            button.setToolButtonStyle(_Style.ToolButtonIconOnly)
        used += sum(spacing + item.sizeHint().width() for item in items if item is not None)
        for button in self._ordered:
            icon_px = button.sizeHint().width()
            button.setToolButtonStyle(_Style.ToolButtonTextBesideIcon)
            more = button.sizeHint().width() - icon_px
            if used + more <= self.width():
                used += more
            else:
                button.setToolButtonStyle(_Style.ToolButtonIconOnly)
        layout.invalidate()  # a button without room is hidden, and does not ask for it
        layout.activate()

    def resizeEvent(self, a0: Any) -> None:  # noqa: N802
        """Fit the texts to the new width."""
        super().resizeEvent(a0)
        self._fit_soon.start()

    def actionEvent(self, event: Any) -> None:  # noqa: N802
        """Give every new button a name, and a place in the order of the tab key."""
        super().actionEvent(event)
        for button in self.findChildren(QToolButton):
            button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self._fit_soon.start()

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return a width that does not keep the window from being small."""
        return QSize(200, super().minimumSizeHint().height())


def name_extension(bar: QWidget) -> None:
    """Name Qt's button for what does not fit into a tool bar or menu bar, for screen readers."""
    for button in bar.findChildren(QToolButton):
        if button.objectName().endswith("_ext_button"):
            button.setAccessibleName("more commands")


class ActionTabs(QTabBar):
    """One tab per checkable command: a tab runs its command, and a checked command selects its
    tab.
    """

    def __init__(self, actions: Sequence[QAction], name: str) -> None:
        super().__init__()
        self._actions = tuple(actions)
        self._hidden = set[QAction]()  # unless they are checked
        name_widget(self, f"{name}_tabs", name)
        self.setDrawBase(False)
        self.setExpanding(False)
        self.setUsesScrollButtons(False)
        self.setElideMode(Qt.TextElideMode.ElideNone)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)  # a click leaves the window its keys
        for action in self._actions:
            self.setTabToolTip(self.addTab(action.text()), action.toolTip())
            action.toggled.connect(self._select_checked)
        self.currentChanged.connect(self._run)
        self._select_checked()

    def offer(self, action: QAction, *, offered: bool) -> None:
        """Show the tab of a command, or hide it while it is not checked."""
        self._hidden = self._hidden - {action} if offered else self._hidden | {action}
        self._select_checked()

    def _select_checked(self, _: bool = False) -> None:
        for i, action in enumerate(self._actions):
            is_offered = action.isChecked() or action not in self._hidden
            if self.isTabVisible(i) != is_offered:
                self.setTabVisible(i, is_offered)
                self.updateGeometry()
            if action.isChecked() and i != self.currentIndex():
                with QSignalBlocker(self):
                    self.setCurrentIndex(i)
                self.update()

    def _run(self, at: int) -> None:
        if 0 <= at < len(self._actions) and not self._actions[at].isChecked():
            self._actions[at].trigger()
