"""The arrangements of the window: commands that change them, and what each brings with it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from PyQt6.QtCore import QObject

from app.frame.instrument import Instrument
from app.session.layout import DIMS, LAYOUTS, Dims, Layout, LayoutName
from app.session.state import Session
from pipeline.scoring.beside import Versus

_OF_PANES = "panes"  # changes of panes that follow each other are one undo step


class Layouts(QObject):
    """Between the session's layout and the window's."""

    def __init__(self, instrument: Instrument) -> None:
        super().__init__(instrument)
        self._instrument, self._window = instrument, instrument.window
        self._before: Versus | None = None  # what was shown before *Align*
        self._opened = False  # whether its drawer came with it
        self._shown: LayoutName = "stages"
        window, panes = self._window, self._window.panes
        for name in LAYOUTS:
            window.on(f"layout_{name}", partial(self.choose, name))
        window.on("inspect_or_stages", self._change_between)
        panes.slot_chosen.connect(self._choose_slot)
        panes.dims_chosen.connect(self._choose_dims)
        panes.count_chosen.connect(self._choose_count)
        instrument.session_shown.connect(self._show_session)
        window.show_layout(instrument.session.layout)

    @property
    def _now(self) -> Layout:
        """The layout with its panes as they stand, those of slots that the route lacks filled by others."""
        layout = self._instrument.session.layout
        return replace(layout, panes=layout.panes_of(self._window.here) or layout.panes)

    def choose(self, name: LayoutName) -> None:
        """Arrange the window so."""
        layout = replace(self._instrument.session.layout, name=name, own=None)
        self._instrument.change(f"show {name}", layout=layout)
        self._window.show_layout(self._instrument.session.layout)  # the command's tick, if it was chosen already

    def show_slot(self, slot: str) -> None:
        """Put a slot into the active pane."""
        self._arrange(self._now.with_slot(self._window.panes.active, slot))

    def _change_between(self) -> None:
        self.choose("stages" if self._instrument.session.layout.name == "inspect" else "inspect")

    def _arrange(self, layout: Layout) -> None:
        self._instrument.change("arrange the panes", key=_OF_PANES, layout=layout)

    def _choose_slot(self, pane: int, slot: str) -> None:
        self._arrange(self._now.with_slot(pane, slot))

    def _choose_count(self, count: int) -> None:
        self._arrange(self._now.with_count(count, self._window.here))

    def _choose_dims(self, pane: int, dims: str) -> None:
        known: Dims = next(d for d in DIMS if d == dims)
        self._arrange(self._now.with_dims(pane, known))

    def _show_session(self, session: Session) -> None:
        """*Align* comes with its drawer and the difference to what was felt, *Demo* without any."""
        drawer, name = self._window.drawers.alignment, session.layout.name
        aligned = name == "align"
        if name == "demo" and self._shown != "demo":
            for other in self._window.drawers.all:
                other.hide()
        self._shown = name
        if aligned and self._before is None:
            self._before, self._opened = self._instrument.screen.versus, drawer.isHidden()
            drawer.show()
            drawer.raise_()
            self._instrument.show_versus(self._before or "difference")
        elif not aligned and self._before is not None:
            before, self._before = self._before, None
            if self._opened:
                drawer.hide()
            self._instrument.show_versus(before)
