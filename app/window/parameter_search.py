"""The parameters of the route as commands of the palette: each goes to its control."""

from functools import partial

from PyQt6.QtCore import QObject, Qt
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QWidget

from app.window.main_window import MainWindow


def make_parameter_actions(window: MainWindow, parent: QObject) -> list[QAction]:
    """One action per parameter of the methods in use; those made before for `parent` are deleted."""
    for old in parent.findChildren(QAction):
        old.deleteLater()
    actions: list[QAction] = []
    for title, setting, control in window.parameters.list_shown():
        action = QAction(f"{setting.label} ({title})", parent)
        action.setToolTip(control.toolTip())
        action.triggered.connect(partial(_focus_parameter, window, control))
        actions.append(action)
    return actions


def _focus_parameter(window: MainWindow, control: QWidget, _checked: bool = False) -> None:
    """Give the keyboard to a control, in its column if it is visible there, else in the Parameters drawer."""
    key, _, name = control.objectName().rpartition(".")
    column = window.columns[key.partition("/")[0]] if "/" in key else None
    if column is not None and name in column.pinned.names and column.pinned.isVisible():
        control = column.pinned.get_control(name)
    else:
        window.show_drawer(window.drawers.parameters)
        window.parameters.ensureWidgetVisible(control)
    target = next((child for child in control.findChildren(QWidget) if _takes_focus(child)), control)
    target.setFocus(Qt.FocusReason.ShortcutFocusReason)


def _takes_focus(widget: QWidget) -> bool:
    return widget.focusPolicy() != Qt.FocusPolicy.NoFocus and not widget.isHidden()
