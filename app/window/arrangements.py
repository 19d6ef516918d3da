"""The user's own arrangements: kept under a name, chosen by menu, palette or key, renamed, deleted."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from PyQt6.QtCore import QObject
from PyQt6.QtGui import QAction, QKeySequence
from PyQt6.QtWidgets import QMenu

from app.session import arrangement_file
from app.session.layout import Arrangement, Layout
from app.session.state import Session
from app.window import dialogs
from app.window.autosave import AutosaveController
from app.window.session_controller import SessionController
from pipeline.base.errors import TouchError

_KEYS = 9  # the first ones have Ctrl+Alt+1 to 9


class ArrangementController(QObject):
    """Between the file of arrangements, the Layout menu, and the session."""

    def __init__(self, controller: SessionController, keeping: AutosaveController) -> None:
        super().__init__(controller)
        self._controller, self._window = controller, controller.window
        self._path = keeping.preferences.settings_folder / arrangement_file.ARRANGEMENTS_FILE
        self._menu = QMenu("Own arrangements", self._window)
        self._window.menus["Layout"].addMenu(self._menu)
        self._actions: list[QAction] = []
        self.arrangements: tuple[Layout, ...] = ()
        try:
            self.arrangements = arrangement_file.load_arrangements(self._path)
        except TouchError as error:
            controller.show_problem(error)
        self._window.connect_command("save_arrangement", self._keep)
        self._window.connect_command("rename_arrangement", self._rename)
        self._window.connect_command("delete_arrangement", self._delete)
        controller.session_shown.connect(self._show_session)
        self._list()
        self._show_session(controller.session)

    def apply_arrangement(self, layout: Layout) -> None:
        """Arrange the window so, even if it was chosen already and moved since."""
        assert layout.arrangement is not None
        self._controller.change(f"arrange as {layout.arrangement.name}", layout=layout)
        self._window.show_layout(layout, anew=True)

    def save_arrangement(self, name: str) -> None:
        """Keep the window as it stands under this name; one that had the name before is replaced."""
        now = replace(self._controller.session.layout, arrangement=self._window.capture_arrangement(name))
        place = next((i for i, one in enumerate(self.arrangements) if _name(one) == name), len(self.arrangements))
        self._write((*self.arrangements[:place], now, *self.arrangements[place + 1 :]))
        self._controller.change(f"keep the arrangement {name}", layout=now)

    def _keep(self) -> None:
        name = dialogs.ask_name(self._window, "Keep this arrangement", self._own or "")
        if name:
            self.save_arrangement(name)

    def _rename(self) -> None:
        old = self._own
        name = dialogs.ask_name(self._window, "Rename the arrangement", old)
        if not name or name == old:
            return
        new = [_named(one, name) if _name(one) == old else one for one in self.arrangements if _name(one) != name]
        self._write(tuple(new))
        self._controller.change("rename the arrangement", layout=_named(self._controller.session.layout, name))

    def _delete(self) -> None:
        old = self._own
        self._write(tuple(one for one in self.arrangements if _name(one) != old))
        self._controller.change(
            "delete the arrangement", layout=replace(self._controller.session.layout, arrangement=None)
        )

    @property
    def _own(self) -> str:
        return _name(self._controller.session.layout)

    def _write(self, layouts: tuple[Layout, ...]) -> None:
        try:
            arrangement_file.save_arrangements(self._path, layouts)
        except (TouchError, OSError) as error:
            self._controller.show_problem(error)
            return
        self.arrangements = layouts
        self._list()

    def _list(self) -> None:
        """An action for each, in the menu and in the palette."""
        for old in self._actions:
            self._window.removeAction(old)
            old.deleteLater()
        self._menu.clear()
        self._actions = [self._action(i, layout) for i, layout in enumerate(self.arrangements)]
        self._window.addActions(self._actions)
        self._menu.addActions(self._actions)
        self._menu.setEnabled(bool(self._actions))
        self._show_session(self._controller.session)

    def _action(self, place: int, layout: Layout) -> QAction:
        action = QAction(f"Arrangement {_name(layout)}", self)
        action.setObjectName(f"arrangement_{place + 1}")
        action.setCheckable(True)
        action.setToolTip(f"Arrange the window as it was kept under {_name(layout)!r}")
        if place < _KEYS:
            action.setShortcut(QKeySequence(f"Ctrl+Alt+{place + 1}"))
        action.triggered.connect(partial(self.apply_arrangement, layout))
        return action

    def _show_session(self, session: Session) -> None:
        own = _name(session.layout)
        for layout, action in zip(self.arrangements, self._actions, strict=True):
            action.setChecked(_name(layout) == own)
        kept = own in {_name(layout) for layout in self.arrangements}
        for command in ("rename_arrangement", "delete_arrangement"):
            self._window.actions_by_name[command].setEnabled(kept)


def _name(layout: Layout) -> str:
    return "" if layout.arrangement is None else layout.arrangement.name


def _named(layout: Layout, name: str) -> Layout:
    return replace(
        layout, arrangement=Arrangement(name) if layout.arrangement is None else replace(layout.arrangement, name=name)
    )
