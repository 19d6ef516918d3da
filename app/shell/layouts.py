"""Layouts: the commands that change them, and the drawer and mode that come with *Align*."""

from dataclasses import replace
from functools import partial

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.session.layout import DIMS, LAYOUT_NAMES, Dims, Layout, LayoutName
from pipeline.translation.truth_view import ComparisonMode

_PANES_KEY = "panes"  # consecutive changes of panes are one undo step


class LayoutController(Feature):
    """Connects the layout commands with the session."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._mode_before_align: ComparisonMode | None = None  # None outside Align
        self._opened_drawer = False  # whether Align opened the alignment drawer
        window = self._window
        for name in LAYOUT_NAMES:
            window.connect_command(f"layout_{name}", partial(self.choose_layout, name))
        for i, name in enumerate(window.columns):
            window.connect_command(f"stage_{i + 1}", partial(self.show_stage, name))
        window.look.stage_chosen.connect(self._choose_stage)
        window.look.stage_toggled.connect(self._toggle_stage)
        window.look.dims_chosen.connect(self._choose_dims)
        window.verdict.finding_chosen.connect(self.show_stage)
        window.show_layout(controller.session.layout)

    @property
    def _resolved_layout(self) -> Layout:
        """*Look* with panes of stages that the route computes."""
        layout = replace(self._session.layout, name="look")
        return replace(
            layout, panes=layout.resolve_panes(self._window.route_columns) or layout.panes
        )

    def choose_layout(self, name: LayoutName) -> None:
        """Change to a layout."""
        layout = replace(self._session.layout, name=name)
        self._change(f"show {name}", layout=layout)
        self._window.show_layout(self._session.layout)  # resets the command's check mark

    def show_stage(self, stage: str) -> None:
        """Show a stage of the route in *Look*, in the pane that has it, else in the active one."""
        if stage in self._window.route_columns:
            self._arrange(self._resolved_layout)
            self._window.look.choose_stage(stage)

    def _arrange(self, layout: Layout) -> None:
        self._change("arrange panes", key=_PANES_KEY, layout=layout)

    def _choose_stage(self, pane: int, stage: str) -> None:
        self._arrange(self._resolved_layout.with_stage(pane, stage))

    def _toggle_stage(self, stage: str) -> None:
        self._arrange(self._resolved_layout.with_toggled(stage))

    def _choose_dims(self, pane: int, dims: str) -> None:
        chosen: Dims = next(d for d in DIMS if d == dims)
        self._arrange(self._resolved_layout.with_dims(pane, chosen))

    def show_session(self) -> None:
        """Open drawer and difference mode for *Align*, and undo that afterwards."""
        drawer = self._window.drawers.alignment
        is_align = self._session.layout.name == "align"
        if is_align and self._mode_before_align is None:
            self._mode_before_align = self._views.comparison_mode
            self._opened_drawer = drawer.isHidden()
            self._window.show_drawer(drawer)
            self._controller.set_comparison_mode(self._mode_before_align or "difference")
        elif not is_align and self._mode_before_align is not None:
            mode = self._mode_before_align
            self._mode_before_align = None
            if self._opened_drawer:
                drawer.hide()
            self._controller.set_comparison_mode(mode)
