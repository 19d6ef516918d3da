"""Step through: the kept iterations of a stage, by a slider under its 3D view and as curves in a
tab.
"""

from dataclasses import replace
from functools import partial

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.views.stage_previews import StagePreview
from pipeline.core.graph import Method
from pipeline.core.params import list_settings, replace_value

_KEEP_PREFIX = "keep_"  # of the parameters that keep iterations
_DEFAULT_STAGE = "pose"
_NOT_ASKED = "Step through keeps the steps and shows them one by one; the result stays the same."
_NO_STEPS = "This method keeps no iterations. Choose another method."
_NOT_YET = "Iterations are kept from the next result on."
_NO_ITERATIONS = "This result took no iterations."


class StepScrubberController(Feature):
    """Connects the tab and the sliders under the 3D views with the session.

    Iterations are kept only on request.
    """

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._stage = _DEFAULT_STAGE  # that the tab shows
        self._panel = self._window.steps_panel
        self._panel.plot.step_chosen.connect(self._set_step)
        for stage, slider in self._window.steps.items():
            slider.keep_steps_requested.connect(self.show_steps_of)
            slider.slider.valueChanged.connect(partial(self._show_step, stage))
        controller.frame_shown.connect(self.show_session)
        self._window.connect_command("step_through", lambda: self.show_steps_of(self._stage))

    def show_steps_of(self, stage: str) -> None:
        """Show the tab, and keep the iterations of a stage from now on."""
        window, session = self._window, self._controller.session
        self._stage = stage
        window.show_diagnostics(self._panel)
        if stage in window.route_columns and stage not in window.visible_columns():
            layout = replace(session.layout, name="look")
            self._controller.change("show stages", layout=layout)
        method = self._get_method(stage)
        if method is not None and (name := _find_keep_parameter(method)):
            kept = replace_value(session.get_params(method), name, value=True)
            self._controller.change("keep iterations", params={**session.params, method.key: kept})
        self.show_session()

    def _get_method(self, stage: str) -> Method | None:
        return next((m for m in self._controller.methods if m.stage == stage), None)

    def show_session(self, *_: object) -> None:
        """Show the iterations of the chosen stage, or why there are none."""
        controller = self._controller
        for stage, slider in self._window.steps.items():
            method = self._get_method(stage)
            slider.set_can_keep_steps(
                can_keep=method is not None and bool(_find_keep_parameter(method))
            )
        method = self._get_method(self._stage)
        part = controller.views.get_shown_stage(self._stage)
        history = part.step_history if isinstance(part, StagePreview) else None
        name = "" if method is None else _find_keep_parameter(method)
        why_not = _NO_STEPS
        if method is not None and name:
            is_kept = list_settings(controller.session.get_params(method))[name][0]
            known = _NO_ITERATIONS if controller.is_idle else _NOT_YET
            why_not = known if is_kept else _NOT_ASKED
        title = controller.catalogue.stage(self._stage).title
        self._panel.show_history(title, history, why_not)
        if history is not None:
            self._panel.show_step(self._window.steps[self._stage].slider.value())

    def _set_step(self, at: int) -> None:
        self._window.steps[self._stage].slider.setValue(at)

    def _show_step(self, stage: str, at: int) -> None:
        if stage == self._stage:
            self._panel.show_step(at)


def _find_keep_parameter(method: Method) -> str:
    """Return the parameter that makes a method keep its iterations, "" if none."""
    return next(
        (name for name in list_settings(method.params()) if name.startswith(_KEEP_PREFIX)), ""
    )
