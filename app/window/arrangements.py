"""The user's arrangements: saved under a name, opened by menu, palette or shortcut, renamed, deleted."""

from dataclasses import replace
from functools import partial

from PyQt6.QtCore import QObject
from PyQt6.QtGui import QAction, QKeySequence
from PyQt6.QtWidgets import QMenu

from app.session.layout import ARRANGEMENTS_FILE, Arrangement, Layout, load_arrangements, save_arrangements
from app.session.state import Session
from app.window import dialogs
from app.window.autosave import AutosaveController
from app.window.session_controller import SessionController
from pipeline.base.errors import TouchError

_N_SHORTCUTS = 9  # the first arrangements get Ctrl+Alt+1 to 9


class ArrangementController(QObject):
    """Connects the arrangements file, the Layout menu and the session."""

    def __init__(self, controller: SessionController, autosave: AutosaveController) -> None:
        super().__init__(controller)
        self._controller, self._window = controller, controller.window
        self._path = autosave.preferences.settings_folder / ARRANGEMENTS_FILE
        self._menu = QMenu("Arrangements", self._window)
        self._window.menus["Layout"].addMenu(self._menu)
        self._actions: list[QAction] = []
        self.arrangements: tuple[Layout, ...] = ()
        try:
            self.arrangements = load_arrangements(self._path)
        except TouchError as error:
            controller.show_problem(error)
        self._window.connect_command("save_arrangement", self._ask_and_save)
        self._window.connect_command("rename_arrangement", self._rename)
        self._window.connect_command("delete_arrangement", self._delete)
        self._update_actions()
        self.show_session(controller.session)

    def apply_arrangement(self, layout: Layout) -> None:
        """Restore an arrangement, also if it is the current one."""
        assert layout.arrangement is not None
        self._controller.change(f"arrange as {layout.arrangement.name}", layout=layout)
        self._window.show_layout(layout, force=True)

    def save_arrangement(self, name: str) -> None:
        """Save the current arrangement under a name, replacing one of that name."""
        layout = replace(self._controller.session.layout, arrangement=self._window.capture_arrangement(name))
        place = next((i for i, one in enumerate(self.arrangements) if _get_name(one) == name), len(self.arrangements))
        self._write((*self.arrangements[:place], layout, *self.arrangements[place + 1 :]))
        self._controller.change(f"save arrangement {name}", layout=layout)

    def _ask_and_save(self) -> None:
        name = dialogs.ask_name(self._window, "Save arrangement", self._current_name or "")
        if name:
            self.save_arrangement(name)

    def _rename(self) -> None:
        old = self._current_name
        name = dialogs.ask_name(self._window, "Rename arrangement", old)
        if not name or name == old:
            return
        new = [
            _rename_layout(one, name) if _get_name(one) == old else one
            for one in self.arrangements
            if _get_name(one) != name
        ]
        self._write(tuple(new))
        self._controller.change("rename arrangement", layout=_rename_layout(self._controller.session.layout, name))

    def _delete(self) -> None:
        old = self._current_name
        self._write(tuple(one for one in self.arrangements if _get_name(one) != old))
        self._controller.change("delete arrangement", layout=replace(self._controller.session.layout, arrangement=None))

    @property
    def _current_name(self) -> str:
        return _get_name(self._controller.session.layout)

    def _write(self, layouts: tuple[Layout, ...]) -> None:
        try:
            save_arrangements(self._path, layouts)
        except (TouchError, OSError) as error:
            self._controller.show_problem(error)
            return
        self.arrangements = layouts
        self._update_actions()

    def _update_actions(self) -> None:
        """Create one action per arrangement, for menu and palette."""
        for old in self._actions:
            self._window.removeAction(old)
            old.deleteLater()
        self._menu.clear()
        self._actions = [self._make_action(i, layout) for i, layout in enumerate(self.arrangements)]
        self._window.addActions(self._actions)
        self._menu.addActions(self._actions)
        self._menu.setEnabled(bool(self._actions))
        self.show_session(self._controller.session)

    def _make_action(self, place: int, layout: Layout) -> QAction:
        action = QAction(f"Arrangement {_get_name(layout)}", self)
        action.setObjectName(f"arrangement_{place + 1}")
        action.setCheckable(True)
        action.setToolTip(f"Restore the arrangement {_get_name(layout)!r}")
        if place < _N_SHORTCUTS:
            action.setShortcut(QKeySequence(f"Ctrl+Alt+{place + 1}"))
        action.triggered.connect(partial(self.apply_arrangement, layout))
        return action

    def show_session(self, session: Session) -> None:
        """Check the action of the current arrangement."""
        current = _get_name(session.layout)
        for layout, action in zip(self.arrangements, self._actions, strict=True):
            action.setChecked(_get_name(layout) == current)
        is_saved = current in {_get_name(layout) for layout in self.arrangements}
        for command in ("rename_arrangement", "delete_arrangement"):
            self._window.actions_by_name[command].setEnabled(is_saved)


def _get_name(layout: Layout) -> str:
    return "" if layout.arrangement is None else layout.arrangement.name


def _rename_layout(layout: Layout, name: str) -> Layout:
    return replace(
        layout, arrangement=Arrangement(name) if layout.arrangement is None else replace(layout.arrangement, name=name)
    )
