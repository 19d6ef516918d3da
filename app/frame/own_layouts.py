"""The user's own arrangements: kept under a name, chosen by menu, palette or key, renamed, deleted."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from PyQt6.QtCore import QObject
from PyQt6.QtGui import QAction, QKeySequence
from PyQt6.QtWidgets import QMenu

from app.frame import dialogs
from app.frame.instrument import Instrument
from app.frame.keeping import Keeping
from app.session import arrangements
from app.session.layout import Layout, Own
from app.session.state import Session
from pipeline.base.errors import TouchError

_KEYS = 9  # the first ones have Ctrl+Alt+1 to 9


class OwnLayouts(QObject):
    """Between the file of arrangements, the Layout menu, and the session."""

    def __init__(self, instrument: Instrument, keeping: Keeping) -> None:
        super().__init__(instrument)
        self._instrument, self._window = instrument, instrument.window
        self._path = keeping.remembered.folder_of_settings / arrangements.FILE
        self._menu = QMenu("Own arrangements", self._window)
        self._window.menus["Layout"].addMenu(self._menu)
        self._actions: list[QAction] = []
        self.known: tuple[Layout, ...] = ()
        try:
            self.known = arrangements.load(self._path)
        except TouchError as error:
            instrument.show_problem(error)
        self._window.on("keep_arrangement", self._keep)
        self._window.on("rename_arrangement", self._rename)
        self._window.on("delete_arrangement", self._delete)
        instrument.session_shown.connect(self._show_session)
        self._list()
        self._show_session(instrument.session)

    def choose(self, layout: Layout) -> None:
        """Arrange the window so, even if it was chosen already and moved since."""
        assert layout.own is not None
        self._instrument.change(f"arrange as {layout.own.name}", layout=layout)
        self._window.show_layout(layout, anew=True)

    def keep(self, name: str) -> None:
        """Keep the window as it stands under this name; one that had the name before is replaced."""
        now = replace(self._instrument.session.layout, own=self._window.arranged(name))
        place = next((i for i, one in enumerate(self.known) if _name(one) == name), len(self.known))
        self._write((*self.known[:place], now, *self.known[place + 1 :]))
        self._instrument.change(f"keep the arrangement {name}", layout=now)

    def _keep(self) -> None:
        name = dialogs.name_of(self._window, "Keep this arrangement", self._own or "")
        if name:
            self.keep(name)

    def _rename(self) -> None:
        old = self._own
        name = dialogs.name_of(self._window, "Rename the arrangement", old)
        if not name or name == old:
            return
        new = [_named(one, name) if _name(one) == old else one for one in self.known if _name(one) != name]
        self._write(tuple(new))
        self._instrument.change("rename the arrangement", layout=_named(self._instrument.session.layout, name))

    def _delete(self) -> None:
        old = self._own
        self._write(tuple(one for one in self.known if _name(one) != old))
        self._instrument.change("delete the arrangement", layout=replace(self._instrument.session.layout, own=None))

    @property
    def _own(self) -> str:
        return _name(self._instrument.session.layout)

    def _write(self, layouts: tuple[Layout, ...]) -> None:
        try:
            arrangements.save(self._path, layouts)
        except (TouchError, OSError) as error:
            self._instrument.show_problem(error)
            return
        self.known = layouts
        self._list()

    def _list(self) -> None:
        """An action for each, in the menu and in the palette."""
        for old in self._actions:
            self._window.removeAction(old)
            old.deleteLater()
        self._menu.clear()
        self._actions = [self._action(i, layout) for i, layout in enumerate(self.known)]
        self._window.addActions(self._actions)
        self._menu.addActions(self._actions)
        self._menu.setEnabled(bool(self._actions))
        self._show_session(self._instrument.session)

    def _action(self, place: int, layout: Layout) -> QAction:
        action = QAction(f"Arrangement {_name(layout)}", self)
        action.setObjectName(f"arrangement_{place + 1}")
        action.setCheckable(True)
        action.setToolTip(f"Arrange the window as it was kept under {_name(layout)!r}")
        if place < _KEYS:
            action.setShortcut(QKeySequence(f"Ctrl+Alt+{place + 1}"))
        action.triggered.connect(partial(self.choose, layout))
        return action

    def _show_session(self, session: Session) -> None:
        own = _name(session.layout)
        for layout, action in zip(self.known, self._actions, strict=True):
            action.setChecked(_name(layout) == own)
        kept = own in {_name(layout) for layout in self.known}
        for command in ("rename_arrangement", "delete_arrangement"):
            self._window.actions_by_name[command].setEnabled(kept)


def _name(layout: Layout) -> str:
    return "" if layout.own is None else layout.own.name


def _named(layout: Layout, name: str) -> Layout:
    return replace(layout, own=Own(name) if layout.own is None else replace(layout.own, name=name))
