"""*Step through*: the kept steps of a slot in its column, under the slider there and in a tab with their curves."""

from __future__ import annotations

from functools import partial

from PyQt6.QtCore import QObject

from app.session.layout import Layout
from app.window.session_controller import SessionController
from app.work.stage_previews import StagePreview
from pipeline.base.params import list_settings, replace_value
from pipeline.engine.graph import Method

_KEEPS = "keep_"  # how the parameters begin that keep steps
_USUAL = "pose"
_CANNOT = "{} keeps no steps; choose another method for it"
_ON_ITS_WAY, _NONE_HERE = "steps are kept from the next answer on", "this answer took no steps"


class StepScrubberController(QObject):
    """Between the tab, the sliders under the 3D views and the session; steps are kept only where somebody asks."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller, self._panel = controller, controller.window.steps_panel
        window, panel = controller.window, self._panel
        panel.stage_chosen.connect(self._show)
        panel.keep_steps_requested.connect(self.set_keep_steps)
        panel.step_chosen.connect(self._choose)
        for slot, slider in window.steps.items():
            slider.keep_steps_requested.connect(self.show_steps_of)
            slider.slider.valueChanged.connect(partial(self._at, slot))
        controller.frame_shown.connect(self._show)
        controller.session_shown.connect(self._show)
        window.connect_command("step_through", lambda: self.show_steps_of(self._panel.stage or _USUAL))

    def show_steps_of(self, stage: str) -> None:
        """Bring the tab to the front, and keep the steps of a slot from now on."""
        window, layout = self._controller.window, self._controller.session.layout
        window.drawers.diagnostics.show()
        window.drawers.diagnostics.raise_()
        window.tabs.setCurrentWidget(self._panel)
        self._panel.choose_stage(stage)
        if stage in window.route_columns and stage not in window.visible_columns():
            self._controller.change("show stages", layout=Layout(panes=layout.panes))
        self.set_keep_steps(stage, keep=True)
        self._show()

    def set_keep_steps(self, stage: str, keep: bool) -> None:
        """Whether the steps of a slot are kept."""
        method = self._method(stage)
        if method is not None and (name := _keeps(method)):
            session = self._controller.session
            params = {**session.params, method.key: replace_value(session.get_params(method), name, keep)}
            self._controller.change("keep steps" if keep else "keep no steps", params=params)

    def _method(self, stage: str) -> Method | None:
        opened = self._controller.views.translation
        return None if opened is None else next((m for m in opened.methods if m.stage == stage), None)

    def _show(self, *_: object) -> None:
        controller, window, panel = self._controller, self._controller.window, self._panel
        titles = {slot: controller.catalogue.stage(slot).title for slot in window.route_columns if slot in window.steps}
        panel.offer_stages(titles)
        for slot, slider in window.steps.items():
            slider.set_can_keep_steps(can_keep=(method := self._method(slot)) is not None and bool(_keeps(method)))
        method, part = self._method(panel.stage), controller.views.get_shown_stage(panel.stage)
        name = "" if method is None else _keeps(method)
        kept = bool(name) and method is not None and bool(list_settings(controller.session.get_params(method))[name][0])
        way = part.step_history if isinstance(part, StagePreview) else None
        why_not = _CANNOT.format(titles.get(panel.stage, "this slot")) if method is not None and not name else ""
        if kept and way is None:
            why_not = _NONE_HERE if controller.is_idle else _ON_ITS_WAY
        panel.show_history(way, keeps_steps=kept, can_keep_steps=bool(name), why_not=why_not)
        if way is not None:
            panel.show_step(window.steps[panel.stage].slider.value())

    def _choose(self, stage: str, at: int) -> None:
        self._controller.window.steps[stage].slider.setValue(at)

    def _at(self, stage: str, at: int) -> None:
        if stage == self._panel.stage:
            self._panel.show_step(at)


def _keeps(method: Method) -> str:
    """The parameter that makes a method keep its steps, "" for none."""
    return next((name for name in list_settings(method.params()) if name.startswith(_KEEPS)), "")
