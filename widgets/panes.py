"""Two or three large panes under a filmstrip of all slots."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from typing import Any

from PyQt6.QtCore import QEvent, QObject, pyqtSignal
from PyQt6.QtGui import QResizeEvent
from PyQt6.QtWidgets import QFrame, QHBoxLayout, QLabel, QToolButton, QVBoxLayout, QWidget

from widgets.filmstrip import Filmstrip
from widgets.looks import smaller, spaced
from widgets.pane_split import PaneSplit
from widgets.solid_cell import SolidCell
from widgets.stage_column import StageColumn

MOST_PANES = 3
DIMS = ("2D", "3D", "both")
_FOLDED_BELOW_PX = 550  # a lower page has its height for the panes, and names alone in its strip


class Pane(QFrame):
    """A column and its 3D view, one over the other or alone; `activated` by a click anywhere in it."""

    activated = pyqtSignal()
    dims_chosen = pyqtSignal(str)

    def __init__(self, number: int, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName(f"pane_{number}")
        self.setFrameShape(QFrame.Shape.NoFrame)
        self._rim = QFrame()
        self._rim.setFixedHeight(3)
        self._rim.setAutoFillBackground(True)
        self._buttons = {dims: QToolButton() for dims in DIMS}
        head = spaced(QHBoxLayout(), 1)
        word = QLabel(f"pane {number}")
        smaller(word, 1.0)
        head.addWidget(word)
        head.addStretch(1)
        for dims, button in self._buttons.items():
            button.setText(dims)
            button.setCheckable(True)
            button.setAutoRaise(True)
            smaller(button, 1.0)
            button.setObjectName(f"pane_{number}_{dims.lower()}")
            button.setToolTip(f"Show {'the picture and the 3D view' if dims == 'both' else dims} in this pane")
            button.clicked.connect(partial(self.dims_chosen.emit, dims))
            head.addWidget(button)
        self._both = PaneSplit()
        self._both.setObjectName(f"split_pane_{number}")
        layout = spaced(QVBoxLayout(self), 0)
        layout.addWidget(self._rim)
        layout.addLayout(head)
        layout.addWidget(self._both, 1)
        self._held: tuple[QWidget, ...] = ()

    def hold(self, column: StageColumn, cell: SolidCell, dims: str) -> None:
        """Show these; what was held before must have been taken elsewhere."""
        if self._held != (column, cell):
            self._both.let_go()
            self._both.hold(column, cell)
            for widget in (column, cell):
                _watch(widget, self)
            self._held = (column, cell)
        column.show_wide(True)
        column.view.levels.show()
        column.setVisible(dims != "3D")
        cell.setVisible(dims != "2D")
        for name, button in self._buttons.items():
            button.setChecked(name == dims)

    def let_go(self) -> None:
        """What is held is about to be taken elsewhere."""
        self._both.let_go()
        self._held = ()

    def show_active(self, active: bool) -> None:
        """Whether a click in the filmstrip fills this pane."""
        palette = self.palette()
        self._rim.setPalette(palette)
        role = palette.ColorRole.Highlight if active else palette.ColorRole.Midlight
        self._rim.setBackgroundRole(role)

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """A press on anything in it."""
        if a1 is not None and a1.type() == QEvent.Type.MouseButtonPress and self._held:
            self.activated.emit()
        return super().eventFilter(a0, a1)

    def mousePressEvent(self, a0: Any) -> None:  # noqa: N802
        """A press beside what it holds."""
        super().mousePressEvent(a0)
        self.activated.emit()


class PanesPage(QWidget):
    """The filmstrip over the panes. `slot_chosen(pane, slot)`, `dims_chosen(pane, dims)` and `count_chosen(n)`."""

    slot_chosen = pyqtSignal(int, str)
    dims_chosen = pyqtSignal(int, str)
    count_chosen = pyqtSignal(int)

    def __init__(self, titles: Mapping[str, str], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.filmstrip = Filmstrip(titles)
        self.panes = tuple(Pane(number + 1) for number in range(MOST_PANES))
        self.active = 0
        self._slots: tuple[str, ...] = ()
        self._count = QToolButton()
        self._count.setObjectName("pane_count")
        self._count.setAutoRaise(True)
        self._count.clicked.connect(lambda: self.count_chosen.emit(2 if len(self._slots) == MOST_PANES else MOST_PANES))
        self.filmstrip.add(self._count)
        row = spaced(QHBoxLayout(), 3)
        layout = spaced(QVBoxLayout(self), 2)
        layout.addWidget(self.filmstrip)
        layout.addLayout(row, 1)
        for number, pane in enumerate(self.panes):
            row.addWidget(pane, 1)
            pane.activated.connect(partial(self.activate, number))
            pane.dims_chosen.connect(partial(self.dims_chosen.emit, number))
        self.filmstrip.chosen.connect(self._choose)

    @property
    def active_slot(self) -> str:
        """What stands in the pane that a click in the filmstrip fills; "" where nothing does."""
        return self._slots[self.active] if self._slots else ""

    def activate(self, number: int) -> None:
        """Let a click in the filmstrip fill this pane."""
        self.active = min(number, max(0, len(self._slots) - 1))
        for other, pane in enumerate(self.panes):
            pane.show_active(other == self.active)
        self.filmstrip.show_places(self._slots, self.active_slot)

    def take(self, held: Sequence[tuple[str, StageColumn, SolidCell, str]]) -> None:
        """Show (slot, column, cell, dims) in a pane each."""
        self._slots = tuple(slot for slot, *_ in held)
        for number, pane in enumerate(self.panes):
            pane.setVisible(number < len(held))
            if number < len(held):
                _, column, cell, dims = held[number]
                pane.hold(column, cell, dims)
        more = len(held) < MOST_PANES
        self._count.setText("+" if more else "\N{MINUS SIGN}")
        self._count.setToolTip("Add a third pane" if more else "Take the third pane away")
        self.activate(self.active)

    def resizeEvent(self, a0: QResizeEvent | None) -> None:  # noqa: N802
        """Where there is little height, the panes get it."""
        super().resizeEvent(a0)
        self.filmstrip.fold(self.height() < _FOLDED_BELOW_PX)

    def _choose(self, slot: str) -> None:
        self.slot_chosen.emit(self.active, slot)

    def let_go(self) -> None:
        """Its columns are about to be taken elsewhere."""
        for pane in self.panes:
            pane.let_go()

    def leave_out(self, names: Collection[str]) -> None:
        """Hide what the route does not have."""
        self.filmstrip.leave_out(names)


def _watch(widget: QWidget, by: QObject) -> None:
    """Let `by` see what happens to a widget and all in it."""
    for one in (widget, *widget.findChildren(QWidget)):
        one.removeEventFilter(by)
        one.installEventFilter(by)
