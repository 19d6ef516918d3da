"""Step through: the kept iterations of a stage as curves in a tab, and any of them in its views."""

from dataclasses import replace

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.views.stage_previews import StagePreview
from pipeline.core.graph import Method
from pipeline.core.params import list_settings, replace_value
from pipeline.translation.pixel_trace import SOURCE

_KEEP_PREFIX = "keep_"  # of the parameters that keep iterations
_DEFAULT_STAGE = "pose"
_NO_STEPS = "The method of {} keeps no iterations. Choose another method."
_NOT_YET = "Iterations are kept from the next result on."
_NO_ITERATIONS = "This result took no iterations."


class StepScrubberController(Feature):
    """Connects the tab with the session and the views.

    Iterations are kept only on request.
    """

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._panel = self._window.steps_panel
        window = controller.window
        panel = self._panel
        panel.stage_box.chosen.connect(self.show_session)
        panel.keep_steps_requested.connect(self.set_keep_steps)
        panel.plot.step_chosen.connect(self._set_step)
        window.connect_command(
            "step_through",
            lambda: self.show_steps_of(self._panel.stage_box.choice or _DEFAULT_STAGE),
        )

    def show_steps_of(self, stage: str) -> None:
        """Show the tab, and keep the iterations of a stage from now on."""
        window = self._window
        layout = self._session.layout
        window.show_diagnostics(self._panel)
        self._panel.stage_box.setCurrentIndex(max(0, self._panel.stage_box.findData(stage)))
        if stage in window.route_columns and stage not in window.visible_columns():
            self._change("show stages", layout=replace(layout, name="look"))
        self.set_keep_steps(stage, keep=True)
        self.show_session()

    def set_keep_steps(self, stage: str, keep: bool) -> None:
        """Keep or drop the iterations of a stage."""
        method = self._get_method(stage)
        if method is not None and (name := _find_keep_parameter(method)):
            session = self._session
            params = replace_value(session.get_params(method), name, keep)
            text = "keep iterations" if keep else "drop iterations"
            self._change(text, params={**session.params, method.key: params})

    def _get_method(self, stage: str) -> Method | None:
        methods = () if self._translation is None else self._translation.methods
        return next((method for method in methods if method.stage == stage), None)

    def show_frame(self) -> None:
        """Show its iterations."""
        self.show_session()

    def show_session(self) -> None:
        """Show the iterations of the chosen stage, and whether they are kept."""
        controller = self._controller
        window = self._window
        panel = self._panel
        titles = {
            stage: controller.catalogue.stage(stage).title
            for stage in window.route_columns
            if stage != SOURCE and controller.catalogue.stage(stage).has_steps
        }
        panel.offer_stages(titles)
        chosen = panel.stage_box.choice
        method = self._get_method(chosen)
        part = controller.views.get_shown_stage(chosen)
        name = why_not = ""
        is_kept = False
        if method is not None:
            name = _find_keep_parameter(method)
            if name:
                is_kept = bool(list_settings(self._session.get_params(method))[name][0])
            else:
                why_not = _NO_STEPS.format(titles.get(chosen, "this stage"))
        history = part.step_history if isinstance(part, StagePreview) else None
        if is_kept and history is None:
            why_not = _NO_ITERATIONS if controller.is_idle else _NOT_YET
        panel.show_history(history, keeps_steps=is_kept, can_keep_steps=bool(name), why_not=why_not)

    def _set_step(self, at: int) -> None:
        self._views.show_step(self._panel.stage_box.choice, at)
        self._panel.show_step(at)


def _find_keep_parameter(method: Method) -> str:
    """Return the parameter that makes a method keep its iterations, "" if none."""
    names = list_settings(method.params())
    return next((name for name in names if name.startswith(_KEEP_PREFIX)), "")
