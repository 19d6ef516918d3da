"""Keyboard use: the probe by arrow keys, alignment numbers, and parameters by their names."""

from functools import partial

from PyQt6.QtCore import QEvent, QObject, Qt
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QWidget

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.window.main_window import MainWindow
from widgets.style.base import EventListener
from widgets.views.preview_key_filter import PreviewKeyFilter

_HINT = (
    "arrow keys move the pixel or the section line (Ctrl: end A, Alt: end B), Shift: 10 times as "
    "far; "
    "Enter pins; + and \N{MINUS SIGN} zoom; , and . move the wipe; Tab: next image; P ends"
)


class KeyboardController(Feature):
    """Gives the keyboard focus to images and to the alignment's first number."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._probe = controller.probe
        for name, column in self._columns.items():
            keys = PreviewKeyFilter(column.view)
            keys.pixel_pointed.connect(partial(self._probe.move_to_pixel, name))
            keys.pixel_pinned.connect(partial(self._probe.toggle_pin, name))
            keys.focus_passed.connect(partial(self._focus_next, name))
        self._window.connect_command("probe_by_keys", self._toggle)
        self._window.connect_command("cancel", self._end)
        self._window.connect_command("edit_alignment", self._edit_alignment)
        self._box = self._window.alignment.rows["x"].box
        self._wants_focus = False
        EventListener(self._box, self._focus_box, QEvent.Type.EnabledChange)

    @property
    def focused_column(self) -> str:
        """The column whose image has the keyboard focus; "" if none."""
        columns = self._columns.items()
        return next((name for name, column in columns if column.view.canvas.hasFocus()), "")

    @property
    def _visible_columns(self) -> list[str]:
        columns = self._columns.items()
        return [name for name, one in columns if one.isVisible() and one.view.preview]

    def _toggle(self) -> None:
        if self.focused_column:
            self._end()
            return
        shown = self._visible_columns
        active = self._window.look.active_stage
        if shown:
            self._focus(active if active in shown else shown[0])

    def _focus(self, name: str) -> None:
        self._columns[name].view.canvas.setFocus(Qt.FocusReason.OtherFocusReason)
        self._window.say(_HINT)

    def _focus_next(self, name: str, by: int) -> None:
        shown = self._visible_columns
        if name in shown:
            self._focus(shown[(shown.index(name) + by) % len(shown)])

    def _end(self) -> None:
        if self.focused_column:
            self._window.setFocus()
            self._window.say("")

    def _edit_alignment(self) -> None:
        self._window.show_drawer(self._window.drawers.alignment)
        self._wants_focus = self._translation is not None  # once the box is enabled
        self._focus_box()

    def _focus_box(self) -> None:
        if self._wants_focus and self._box.isEnabled() and self._box.isVisible():
            self._wants_focus = False
            self._box.setFocus(Qt.FocusReason.ShortcutFocusReason)
            self._box.selectAll()


def make_parameter_actions(window: MainWindow, parent: QObject) -> list[QAction]:
    """One action per parameter of the methods in use.

    Those made before for `parent` are deleted.
    """
    for old in parent.findChildren(QAction):
        old.deleteLater()
    actions: list[QAction] = []
    for title, setting, control in window.parameters.list_offered():
        action = QAction(f"{setting.label} ({title})", parent)
        action.setToolTip(control.toolTip())
        action.triggered.connect(partial(_focus_parameter, window, control))
        actions.append(action)
    return actions


def _focus_parameter(window: MainWindow, control: QWidget, _checked: bool = False) -> None:
    """Give the keyboard to a control in the inspector."""
    window.show_inspector()
    window.parameters.reveal(control)
    takers = [
        child
        for child in control.findChildren(QWidget)
        if child.focusPolicy() != Qt.FocusPolicy.NoFocus and not child.isHidden()
    ]
    (takers or [control])[0].setFocus(Qt.FocusReason.ShortcutFocusReason)
