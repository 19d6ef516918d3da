"""*Sweep* at work: two parameters in a thread of their own, cell by cell; a click uses a cell."""

from __future__ import annotations

import time
from pathlib import Path

from PyQt6.QtCore import QObject

from app.session.state import Session
from app.window.session_controller import SessionController
from app.work import parameter_sweep as sweep_jobs
from app.work.jobs import LatestJob
from app.work.requests import make_request
from pipeline.base.errors import SettingProblem, TouchError
from pipeline.base.params import Value
from pipeline.evaluation import parameter_sweep
from pipeline.evaluation.parameter_sweep import SweepCell, SweepPlan
from pipeline.metrics.stage_metrics import METRICS
from pipeline.translation.error_attribution import DEFAULT_METRIC
from widgets.sweep_grid import SweepTrial

_NO_FIGURE = "time only"


class SweepController(QObject):
    """Between the page and the instrument. What was begun for another recording or frame is stopped."""

    def __init__(self, instrument: SessionController) -> None:
        super().__init__(instrument)
        self._instrument, self._page = instrument, instrument.window.sweep
        self._job = LatestJob("sweep", self)
        self._offers: list[sweep_jobs.SweepableParameter] = []
        self._plan: SweepPlan | None = None
        self._begun: Session | None = None
        self._ticket, self._begun_s, self._done = 0, 0.0, 0
        page, job = self._page, self._job
        page.axis_chosen.connect(self._choose_axis)
        page.sweep_requested.connect(self._start)
        page.cancel_requested.connect(job.cancel)
        page.cell_chosen.connect(self._use)
        job.delivered.connect(self._take)
        job.finished.connect(self._finished)
        job.failed.connect(self._failed)
        job.cancelled.connect(self._cancelled)
        instrument.session_shown.connect(self._show_session)
        instrument.frame_shown.connect(self._offer_figures)
        instrument.closing.connect(job.close)

    def format_command(self, target: str, out: Path) -> str:
        """The command that tries what the grid shows, or what would be tried; raises SettingProblem."""
        plan = self._plan if self._begun is not None and self._plan is not None else self._planned()
        return sweep_jobs.format_sweep_command(self._begun or self._instrument.session, plan, target, out)

    @property
    def is_busy(self) -> bool:
        """Whether cells are still to come."""
        return not self._job.is_settled

    def _show_session(self, session: Session) -> None:
        """Offer what the route's methods can be set to, and stop what is about something else."""
        begun = self._begun
        if begun is not None and (make_request(begun) != make_request(session) or begun.frame != session.frame):
            self._job.cancel()
            self._begun = None
        if session.layout.name != "sweep":
            return
        old = [offer[:2] for offer in self._offers]
        self._offers = sweep_jobs.list_sweepable_parameters(
            session, self._instrument.methods, self._instrument.sensor_kinds
        )
        now = [offer[:2] for offer in self._offers]
        chosen = tuple(box.currentIndex() for box in self._page.axes)
        if now != old or min(chosen, default=-1) < 0:
            chosen = sweep_jobs.choose_default_axes(self._offers)
        figures = self._figures()
        figure = self._page.metric_box.currentText()
        words = [offer[2] for offer in self._offers]
        self._page.offer_parameters(words, (chosen[0], chosen[1]), figures, figure if figure in figures else figures[0])
        if now != old:
            for which in (0, 1):
                self._choose_axis(which)

    def _figures(self) -> list[str]:
        """The errors that any frame is known to have, the usual one first."""
        judged = () if self._plan is None or not self._plan.metric else (self._plan.metric,)
        known = dict.fromkeys((*self._instrument.window.frames.model.metrics, *judged))
        names = [name for name in known if METRICS[name.partition(".")[2]].better == "lower"]
        return [*sorted(names, key=lambda name: name != DEFAULT_METRIC), _NO_FIGURE]

    def _offer_figures(self, _: int) -> None:
        if self._instrument.session.layout.name == "sweep":
            self._show_session(self._instrument.session)

    def _choose_axis(self, which: int) -> None:
        index = self._page.axes[which].currentIndex()
        if 0 <= index < len(self._offers):
            *_, value, told = self._offers[index]
            self._page.show_values(which, sweep_jobs.suggest_values(value, told))

    def _planned(self) -> SweepPlan:
        """What the page says; raises SettingProblem."""
        methods = self._instrument.methods
        axes: list[parameter_sweep.SweepAxis] = []
        for box, line in zip(self._page.axes, self._page.values, strict=True):
            if not 0 <= box.currentIndex() < len(self._offers):
                raise SettingProblem("there is nothing to sweep; open a recording first")
            key, name, *_ = self._offers[box.currentIndex()]
            method = parameter_sweep.find_method(methods, key)
            axes.append(
                parameter_sweep.parse_axis(self._instrument.session.get_params(method), method, name, line.text())
            )
        if axes[0].qualified_name == axes[1].qualified_name:
            raise SettingProblem("columns and rows are the same parameter; choose another for one of them")
        figure = self._page.metric_box.currentText()
        return SweepPlan(across=axes[0], down=axes[1], metric="" if figure == _NO_FIGURE else figure)

    def _start(self) -> None:
        try:
            if self._instrument.session.recording is None:
                raise SettingProblem("there is nothing to sweep; open a recording first")
            plan = self._planned()
        except TouchError as error:
            self._page.show_progress(None, str(error))
            return
        session = self._instrument.session
        self._plan, self._begun, self._done, self._begun_s = plan, session, 0, time.monotonic()
        unit = METRICS[plan.metric.partition(".")[2]].unit if plan.metric else ""
        across, down = ((a.qualified_name, _words(a.values)) for a in (plan.across, plan.down))
        self._page.show_empty(across, down, unit)
        self._page.show_progress(0.0, "opening the recording")
        self._ticket = self._job.submit(lambda report: sweep_jobs.run_sweep(session, plan, report))

    def _take(self, ticket: int, cell: object) -> None:
        if ticket != self._ticket or self._plan is None or not isinstance(cell, SweepCell):
            return
        self._done += 1
        tried = SweepTrial(error=cell.error, time_ms=cell.ms, preview=cell.preview, problem=cell.problem)
        self._page.show_cell(cell.row, cell.col, tried)
        whole = len(self._plan.run_order)
        left_s = (time.monotonic() - self._begun_s) / self._done * (whole - self._done)
        self._page.show_progress(self._done / whole, f"{self._done} of {whole} tried, about {left_s:.0f} s to go")

    def _finished(self, ticket: int, count: object) -> None:
        if ticket == self._ticket:
            self._page.show_progress(None, f"{count} tried; a click on a cell uses its values")

    def _failed(self, ticket: int, error: object) -> None:
        if ticket == self._ticket and isinstance(error, BaseException):
            self._page.show_progress(None, str(error))
            self._instrument.show_problem(error)

    def _cancelled(self, ticket: int) -> None:
        if ticket == self._ticket:
            self._page.show_progress(None, f"stopped after {self._done}; what was tried stays")

    def _use(self, row: int, col: int) -> None:
        """Work with a cell's values from now on, as one change."""
        plan = self._plan
        if plan is None:
            return
        methods = {method.key: method for method in self._instrument.methods}
        session = self._instrument.session
        if plan.across.key in methods and plan.down.key in methods:
            params = plan.across.apply_value(session.params, methods[plan.across.key], plan.across.values[col])
            params = plan.down.apply_value(params, methods[plan.down.key], plan.down.values[row])
            self._instrument.change("use a cell of the sweep", params=params)
            self._page.mark_used_cell(row, col)


def _words(values: tuple[Value, ...]) -> list[str]:
    return [f"{value:g}" if isinstance(value, float) else str(value).lower() for value in values]
