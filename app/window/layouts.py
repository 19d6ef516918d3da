"""The arrangements of the window: commands that change them, and what each brings with it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from PyQt6.QtCore import QObject

from app.session.layout import DIMS, LAYOUT_NAMES, Dims, Layout, LayoutName
from app.session.state import Session
from app.window.session_controller import SessionController
from pipeline.evaluation.truth_view import ComparisonMode

_OF_PANES = "panes"  # changes of panes that follow each other are one undo step


class LayoutController(QObject):
    """Between the session's layout and the window's."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller, self._window = controller, controller.window
        self._before: ComparisonMode | None = None  # what was shown before *Align*
        self._opened = False  # whether its drawer came with it
        self._shown: LayoutName = "stages"
        window, panes = self._window, self._window.panes
        for name in LAYOUT_NAMES:
            window.connect_command(f"layout_{name}", partial(self.choose_layout, name))
        window.connect_command("toggle_inspect", self._change_between)
        panes.stage_chosen.connect(self._choose_slot)
        panes.dims_chosen.connect(self._choose_dims)
        panes.count_chosen.connect(self._choose_count)
        controller.session_shown.connect(self._show_session)
        window.show_layout(controller.session.layout)

    @property
    def _now(self) -> Layout:
        """The layout with its panes as they stand, those of slots that the route lacks filled by others."""
        layout = self._controller.session.layout
        return replace(layout, panes=layout.resolve_panes(self._window.route_columns) or layout.panes)

    def choose_layout(self, name: LayoutName) -> None:
        """Arrange the window so."""
        layout = replace(self._controller.session.layout, name=name, arrangement=None)
        self._controller.change(f"show {name}", layout=layout)
        self._window.show_layout(self._controller.session.layout)  # the command's tick, if it was chosen already

    def show_stage(self, stage: str) -> None:
        """Put a slot into the active pane."""
        self._arrange(self._now.with_stage(self._window.panes.active_pane, stage))

    def _change_between(self) -> None:
        self.choose_layout("stages" if self._controller.session.layout.name == "inspect" else "inspect")

    def _arrange(self, layout: Layout) -> None:
        self._controller.change("arrange the panes", key=_OF_PANES, layout=layout)

    def _choose_slot(self, pane: int, stage: str) -> None:
        self._arrange(self._now.with_stage(pane, stage))

    def _choose_count(self, count: int) -> None:
        self._arrange(self._now.with_count(count, self._window.route_columns))

    def _choose_dims(self, pane: int, dims: str) -> None:
        known: Dims = next(d for d in DIMS if d == dims)
        self._arrange(self._now.with_dims(pane, known))

    def _show_session(self, session: Session) -> None:
        """*Align* comes with its drawer and the difference to what was felt, *Demo* without any."""
        drawer, name = self._window.drawers.alignment, session.layout.name
        aligned = name == "align"
        if name == "demo" and self._shown != "demo":
            for other in self._window.drawers.all_drawers:
                other.hide()
        self._shown = name
        if aligned and self._before is None:
            self._before, self._opened = self._controller.views.comparison_mode, drawer.isHidden()
            drawer.show()
            drawer.raise_()
            self._controller.set_comparison_mode(self._before or "difference")
        elif not aligned and self._before is not None:
            before, self._before = self._before, None
            if self._opened:
                drawer.hide()
            self._controller.set_comparison_mode(before)
