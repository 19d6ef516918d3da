"""Parameters tab of *Compare*: sweeps two parameters in a thread of its own; a click uses a cell's values."""

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from app.session.state import Session
from app.window.background_controller import BackgroundController
from app.window.session_controller import SessionController
from app.work.evaluator import Evaluator
from app.work.jobs import JobReporter
from app.work.requests import make_request
from app.work.variants import (
    SweepableParameter,
    choose_default_axes,
    format_compare_command,
    list_sweepable_parameters,
    open_variant,
    suggest_values,
)
from pipeline.base.errors import SettingProblem, TouchError
from pipeline.evaluation.parameter_sweep import (
    SweepAxis,
    SweepCell,
    SweepPlan,
    compare_grid,
    find_method,
    format_value,
    parse_axis,
)
from pipeline.evaluation.variants import Variant, VariantRunner
from pipeline.metrics.stage_metrics import METRICS, describe_metric, is_stage_error
from pipeline.translation.error_attribution import DEFAULT_METRIC

_TIME_ALONE = "time only"


class SweepController(BackgroundController):
    """Connects the tab with the session. A sweep of another recording or frame is cancelled."""

    def __init__(self, controller: SessionController) -> None:
        self._tab = tab = controller.window.comparison.sweep
        super().__init__("sweep", controller, tab.run_bar)
        self._evaluator = Evaluator(controller.catalogue)
        self._parameters: list[SweepableParameter] = []
        self._plan: SweepPlan | None = None
        self._swept: Session | None = None  # session of the sweep that is shown
        self._start_s, self._n_done = 0.0, 0
        for which, box in enumerate(tab.axes):
            box.chosen.connect(partial(self._suggest_values, which))
        tab.start_button.clicked.connect(self._start_sweep)
        for view in (tab.grid, tab.plot):
            view.cell_chosen.connect(self._use_cell)
        controller.frame_shown.connect(self._update_metrics)
        controller.closing.connect(self._evaluator.close)

    def format_command(self, target: str, out: Path) -> str:
        """The command that makes the sweep that is shown, or else the chosen one; raises SettingProblem."""
        plan = self._plan if self._swept is not None and self._plan is not None else self._parse_plan()
        return format_compare_command(self._swept or self._controller.session, "", target, out, plan)

    def show_session(self, session: Session) -> None:
        """Offer the parameters of the methods in use, and cancel a sweep of something else."""
        swept = self._swept
        if swept is not None and (make_request(swept) != make_request(session) or swept.frame != session.frame):
            self.cancel()
            self._swept = None
        if session.layout.name != "sweep":
            return
        old = [parameter[:2] for parameter in self._parameters]
        self._parameters = list_sweepable_parameters(session, self._controller.methods, self._controller.sensor_kinds)
        is_new = [parameter[:2] for parameter in self._parameters] != old
        indices = tuple(box.currentIndex() for box in self._tab.axes)
        if is_new or min(indices, default=-1) < 0:
            indices = choose_default_axes(self._parameters)
        metrics, metric = self._list_metrics(), self._tab.metric_box.choice
        names = [parameter[2] for parameter in self._parameters]
        self._tab.offer_parameters(
            names, (indices[0], indices[1]), metrics, metric if metric in metrics else next(iter(metrics))
        )
        if is_new:
            for which in (0, 1):
                self._suggest_values(which)

    def _list_metrics(self) -> dict[str, str]:
        """The errors (name -> title) of stages known for any frame, the default one first; last none, time alone."""
        planned = () if self._plan is None or not self._plan.metric else (self._plan.metric,)
        known = dict.fromkeys((*self._controller.window.frames.model.metrics, *planned))
        names = [name for name in known if is_stage_error(name)]
        names.sort(key=lambda name: name != DEFAULT_METRIC)
        return {**{name: describe_metric(name) for name in names}, "": _TIME_ALONE}

    def _update_metrics(self, _: int) -> None:
        if self._controller.session.layout.name == "sweep":
            self.show_session(self._controller.session)

    def _suggest_values(self, which: int, _name: str = "") -> None:
        index = self._tab.axes[which].currentIndex()
        if 0 <= index < len(self._parameters):
            *_, value, setting = self._parameters[index]
            self._tab.show_values(which, suggest_values(value, setting))

    def _parse_plan(self) -> SweepPlan:
        """The plan of the tab's controls; raises SettingProblem."""
        axes: list[SweepAxis] = []
        for box, line in zip(self._tab.axes, self._tab.values, strict=True):
            if self._controller.session.recording is None or not 0 <= box.currentIndex() < len(self._parameters):
                raise SettingProblem("there is nothing to sweep; open a recording first")
            key, name, *_ = self._parameters[box.currentIndex()]
            method = find_method(self._controller.methods, key)
            axes.append(parse_axis(self._controller.session.get_params(method), method, name, line.text()))
        if axes[0].qualified_name == axes[1].qualified_name:
            raise SettingProblem("columns and rows are the same parameter; choose another for one of them")
        return SweepPlan(across=axes[0], down=axes[1], metric=self._tab.metric_box.choice)

    def _start_sweep(self) -> None:
        try:
            plan = self._parse_plan()
        except TouchError as error:
            self._tab.show_state(str(error), runs=False)
            return
        session = self._controller.session
        self._plan, self._swept, self._n_done, self._start_s = plan, session, 0, time.monotonic()
        unit = METRICS[plan.metric.partition(".")[2]].unit if plan.metric else ""
        across, down = (_format_axis(axis) for axis in (plan.across, plan.down))
        self._tab.start_sweep(across, down, unit)
        self._tab.show_state("opening the recording", runs=True)
        self.start(lambda report: run_sweep(self._evaluator, session, plan, report))

    def show_part(self, part: object) -> None:
        """Show a cell, and the time left."""
        if self._plan is None or not isinstance(part, SweepCell):
            return
        self._n_done += 1
        self._tab.show_cell(part)
        n_cells = len(self._plan.run_order)
        left_s = (time.monotonic() - self._start_s) / self._n_done * (n_cells - self._n_done)
        self._tab.message.setText(f"{self._n_done} of {n_cells} done, about {left_s:.0f} s left")
        self._tab.run_bar.show_progress(self._n_done / n_cells)

    def show_result(self, result: object) -> None:
        """Show that all cells are done."""
        self._tab.show_state(f"{result} pairs done; click a cell to use its values", runs=False)

    def show_failure(self, error: BaseException) -> None:
        """Show the error in the tab, too."""
        self._tab.show_state(str(error), runs=False)

    def show_cancelled(self) -> None:
        """Show how many cells were computed."""
        self._tab.show_state(f"cancelled after {self._n_done} pairs", runs=False)

    def _use_cell(self, row: int, col: int) -> None:
        """Use a cell's values in the session, as one change."""
        plan, opened = self._plan, self._controller.views.translation
        keys = {method.key for method in self._controller.methods}
        if plan is None or opened is None or not {plan.across.key, plan.down.key} <= keys:
            return
        base = Variant(label="", translation=opened, params=self._controller.session.params)
        self._controller.change("use a cell of the sweep", params=plan.build_variant(base, row, col).params)
        self._tab.mark_used_cell(row, col)


def run_sweep(evaluator: Evaluator, session: Session, plan: SweepPlan, report: JobReporter) -> int:
    """Compute the cells one by one and deliver each; returns their number. Raises TouchError, Cancelled."""
    variant, frame = open_variant("", evaluator, session, report)
    runner, n_cells = VariantRunner(), 0
    for comparison in compare_grid(
        runner, variant.translation, frame, session.params, session.display, plan, report
    ):  # fmt: skip
        report.deliver(comparison.cells[-1])
        n_cells += 1
    return n_cells


def _format_axis(axis: SweepAxis) -> tuple[str, Sequence[str]]:
    return axis.qualified_name, [format_value(value) for value in axis.values]
