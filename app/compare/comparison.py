"""*Compare*: computes variants of the current frame in a thread of its own while the page is
visible.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import cast

from app.compare.variant_jobs import (
    describe_differences,
    format_compare_command,
    label_axes,
    list_axes,
)
from app.document.background_controller import BackgroundController
from app.document.evaluator import Evaluator
from app.document.requests import make_request
from app.document.session_controller import SessionController
from app.session.layout import LAST_STAGE, ComparisonSettings, ComparisonTabName, Layout
from app.session.state import Session
from app.window.jobs import JobReporter
from pipeline.core.errors import SettingProblem, TouchError
from pipeline.core.processes import release_free_memory
from pipeline.lab.evaluation.comparison_tiles import Comparison
from pipeline.lab.evaluation.grid_comparison import GridPlan, compare_grid, parse_axis
from pipeline.lab.evaluation.method_comparison import compare_methods
from pipeline.lab.evaluation.variant_comparison import compare_pair
from pipeline.lab.evaluation.variants import Variant, VariantRunner
from pipeline.stages.metrics.stage_metrics import METRICS, describe_metric, is_stage_error
from pipeline.stages.networks import network_factory
from pipeline.translation.error_attribution import DEFAULT_METRIC
from pipeline.translation.translate import Translation
from widgets.compare.comparison_page import ALL_STAGES
from widgets.compare.comparison_tab import GRID_HINT
from widgets.style.styling import make_single_shot_timer

ComparisonSteps = Callable[[JobReporter], Iterator[Comparison]]
_NO_VARIANT = (
    "hold the current settings and change some, or choose another recording, to "
    "compare both on one frame"
)
_RELEASE_DELAY_MS = 20_000  # between leaving the page and releasing its memory
_NO_DIFFERENCE = "no setting differs yet: further changes are those of A (F3 shows the parameters)"


class ComparisonController(BackgroundController):
    """Connects the page with the session; nothing is computed for a tab that is not visible."""

    shows_errors = True

    def __init__(self, controller: SessionController) -> None:
        self._page = page = controller.window.comparison
        super().__init__("compare", controller, *(tab.run_bar for tab in page.tabs.values()))
        self._evaluators = tuple(
            Evaluator(controller.catalogue, like=controller.evaluator) for _ in "AB"
        )
        self._method_runner = VariantRunner()
        # shares what the columns computed
        self._shared_runner = VariantRunner(like=self._evaluators[0].graph)
        self._requested: tuple[object, ...] = ()
        # that is shown, with the session it was started from
        self._grid: tuple[Session, GridPlan] | None = None
        self._release_timer = make_single_shot_timer(self, _RELEASE_DELAY_MS, self.release_memory)
        self._is_visible = False
        self._summary = ""
        self._shown_settings = (ComparisonSettings(), None)  # when the page was last updated
        window = controller.window
        page.choice_changed.connect(self._choose)
        page.grid.start_button.clicked.connect(self._start_grid)
        page.grid.grid.cell_chosen.connect(self._use_cell)
        for tab in page.tile_tabs:
            tab.grid.readout_changed.connect(window.show_pixel)
        window.connect_command("cancel", self.cancel)
        window.connect_command("reset_view", self._reset_view)
        window.connect_command("set_variant_settings", self.set_variant_settings)
        window.connect_command("clear_variant", self.clear_variant)
        window.actions_by_name["clear_variant"].setEnabled(False)

    def set_variant_settings(self) -> None:
        """Hold the current settings as variant B."""
        self._set_variant(self._session)

    def set_variant_recording(self, path: Path) -> None:
        """Hold another recording with the current settings as variant B."""
        self._set_variant(self._session.with_updates(recording=path))

    def clear_variant(self) -> None:
        """Remove variant B."""
        self._change("clear B", variant=None)

    def release_memory(self) -> None:
        """Drop cached results, and networks that no column uses, unless the page is visible."""
        if self._is_visible or self._controller.is_closed:
            return
        if self.job.is_busy:  # it is being cancelled
            self._release_timer.start()
            return
        self._method_runner.clear()
        for evaluator in self._evaluators:
            evaluator.release_caches()
        network_factory.release_networks(self._controller.evaluator.weights_in_use)
        self.job.submit(lambda _: release_free_memory())

    def _set_variant(self, session: Session) -> None:
        now = self._session
        if now.recording is not None:
            self._change(
                "keep as B",
                variant=replace(session, variant=None),
                comparison=replace(now.comparison, tab="two"),
                layout=replace(now.layout, name="compare"),
            )

    def _choose(self) -> None:
        """Store the page's choices in the session."""
        page = self._page
        session = self._session
        old = session.comparison
        stage = old.stage if page.stage_box.currentIndex() < 0 else page.stage_box.choice
        if old.stage == LAST_STAGE and page.stage_box.currentIndex() == page.stage_box.count() - 1:
            stage = LAST_STAGE
        new = ComparisonSettings(
            tab=cast("ComparisonTabName", page.current_name),
            order=page.order_box.choice,
            stage=stage,
        )
        self._change("choose in Compare", comparison=new)

    def _build_methods(self, session: Session) -> ComparisonSteps:
        def run(report: JobReporter) -> Iterator[Comparison]:
            translation, frame = self._evaluators[0].open_frame(session, report)
            return compare_methods(
                self._method_runner,
                translation,
                frame,
                session.params,
                session.display,
                session.comparison.order,
                report,
            )

        return run

    def _build_pair(self, session: Session) -> ComparisonSteps | str:
        if session.variant is None:
            return _NO_VARIANT
        other = replace(
            session.variant,
            frame=session.frame,
            params={**session.variant.params, "display": session.display},
        )
        stage = self._page.stage_box.choice
        opened = self._translation
        has_mesh = opened is not None and opened.mesh is not None
        differences = describe_differences(
            session, other, self._controller.catalogue, has_mesh=has_mesh
        )

        def open_variant(of: Session, report: JobReporter) -> Variant:
            at = 0 if of is session else 1
            translation, _ = self._evaluators[at].open_frame(of, report)
            return Variant(label="AB"[at], translation=translation, params=of.params)

        def run(report: JobReporter) -> Iterator[Comparison]:
            return compare_pair(
                self._shared_runner,
                open_variant(session, report),
                lambda: open_variant(other, report),
                session.frame,
                session.display,
                stage,
                "; ".join(differences) or _NO_DIFFERENCE,
                report,
                second_may_fail=True,
            )

        return run

    def _parse_plan(self) -> GridPlan:
        """Return the plan of the grid's controls; raises SettingProblem."""
        tab = self._page.grid
        base = self._get_base()
        across, down = tab.axis_texts
        rows = parse_axis(base, down) if down else None
        return GridPlan(across=parse_axis(base, across), down=rows, metric=tab.metric_box.choice)

    def _get_base(self) -> Variant:
        """Return what is open; raises SettingProblem."""
        opened = self._translation
        if opened is None:
            raise SettingProblem("there is nothing to compare; open a recording first")
        return Variant(label="", translation=opened, params=self._session.params)

    def _start_grid(self) -> None:
        session = self._session
        tab = self._page.grid
        try:
            plan = self._parse_plan()
        except TouchError as error:
            tab.message.setText(str(error))
            return
        self._grid = session, plan
        tab.show_plan(plan, METRICS[plan.metric.partition(".")[2]].unit if plan.metric else "")

        def run(report: JobReporter) -> Iterator[Comparison]:
            translation, frame = self._evaluators[0].open_frame(session, report)
            return compare_grid(
                self._method_runner,
                translation,
                frame,
                session.params,
                session.display,
                plan,
                report,
            )

        self.start(lambda report: _deliver_steps(run, report))

    def _follow_grid(self, session: Session) -> None:
        """Offer what the methods in use can try; drop a grid of another recording or frame."""
        controller = self._controller
        tab = self._page.grid
        methods, catalogue = controller.methods, controller.catalogue
        axes = list_axes(session, methods, catalogue, controller.sensor_kinds)
        known = dict.fromkeys((DEFAULT_METRIC, *self._window.frames.model.metrics))
        metrics = {name: describe_metric(name) for name in known if is_stage_error(name)}
        metric = tab.metric_box.choice if tab.metric_box.count() else DEFAULT_METRIC
        labels = label_axes(axes, methods, catalogue)
        tab.offer_axes(axes, {**metrics, "": "time only"}, metric, labels)
        if self._grid is not None and _get_subject(self._grid[0]) != _get_subject(session):
            self.abandon()
            self._grid = None
            tab.show_plan(None)
            tab.message.setText(GRID_HINT)

    def _use_cell(self, row: int, col: int) -> None:
        """Use a cell's values in the session, as one change."""
        if self._grid is None:
            return
        try:
            variant = self._grid[1].build_variant(self._get_base(), row, col)
        except TouchError as error:
            self._page.grid.message.setText(str(error))
            return
        request = variant.translation.request
        self._change(
            "use a cell of the grid",
            params=variant.params,
            methods=dict(request.methods),
            weights=dict(request.weights),
        )
        self._page.grid.grid.setCurrentCell(row, col)

    def format_command(self, opened: Translation, out: Path) -> str:
        """Return the command that writes what the page shows; raises SettingProblem."""
        session = self._session
        plan = None
        if session.comparison.tab == "grid":
            session, plan = self._grid or (session, self._parse_plan())
        elif session.comparison.tab == "two" and session.variant is None:
            raise SettingProblem(_NO_VARIANT)
        return format_compare_command(session, opened.stages[-1], opened.target.name, out, plan)

    def show_session(self) -> None:
        """Cancel what is no longer visible, and update what is."""
        session = self._session
        was_visible = self._is_visible
        self._is_visible = session.layout.name == "compare"
        if self._is_visible:
            self._release_timer.stop()
        elif was_visible:
            self._release_timer.start()
        is_closed = self._translation is None
        if is_closed:  # nothing of the recording before stays, if the next one does not open
            for tab in self._page.tile_tabs:
                tab.show_comparison(Comparison(tiles=(), summary=""))
        if is_closed or not self._is_visible:
            self.abandon()
            self._requested = ()
        self._show_choices(session)
        if (session.comparison, session.variant) != self._shown_settings:
            self._shown_settings = (session.comparison, session.variant)
            self._update()

    def _reset_view(self) -> None:
        for tab in self._page.tile_tabs:
            tab.grid.reset_view()

    def _show_choices(self, session: Session) -> None:
        settings = session.comparison
        self._page.show_choices(settings.tab, settings.order, settings.stage)
        self._actions["clear_variant"].setEnabled(session.variant is not None)

    def _update(self) -> None:
        """Compute the current tab, unless it shows that already."""
        page, session, opened = self._page, self._session, self._translation
        if not self._is_visible or opened is None or self._controller.is_closed:
            return
        stages = {name: opened.catalogue.stage(name).title for name in opened.stages}
        page.stage_box.offer({"": ALL_STAGES, **stages})
        self._show_choices(session)
        if page.current_name == "grid":
            if self._requested:  # by another tab
                self.abandon()
                self._requested = ()
            self._follow_grid(session)
            return
        for tab in page.tile_tabs:
            tab.grid.set_comparison_mode(self._views.comparison_mode)
        settings = session.with_updates(
            layout=Layout(), cameras_linked=True, comparison=ComparisonSettings(), variant=None
        )
        is_pair = page.current_name == "two"
        choice = (page.stage_box.choice, session.variant) if is_pair else session.comparison.order
        requested = (is_pair, choice, settings)
        if requested == self._requested:
            return
        old = self._requested[-1] if self._requested else None
        # The next frame waits for the one in progress, so that playing shows something on its way.
        is_next_frame = (
            isinstance(old, Session)
            and make_request(old) == make_request(session)
            and requested[:-1] == self._requested[:-1]
        )
        self._requested = requested
        steps = self._build_pair(session) if is_pair else self._build_methods(session)
        if isinstance(steps, str):
            self.abandon()
            self._show(Comparison(tiles=(), summary=steps))
            return
        self.start(lambda report: _deliver_steps(steps, report), interrupt=not is_next_frame)

    def show_part(self, part: object) -> None:
        """Show the tiles that are done."""
        if isinstance(part, Comparison):
            self._show(part)

    def _show(self, comparison: Comparison) -> None:
        self._page.current_tab.show_comparison(comparison)
        self._summary = comparison.summary

    def show_result(self, result: object) -> None:
        """Show all tiles."""
        self.show_part(result)

    def show_failure(self, error: BaseException) -> None:
        """Show the error in place of the tiles."""
        self._show(Comparison(tiles=(), summary=str(error)))

    def show_cancelled(self) -> None:
        """Show that tiles are missing."""
        self._page.current_tab.message.setText(
            f"cancelled; {self._summary}" if self._summary else "cancelled"
        )

    def show_frame(self) -> None:
        """Compute the tab for it."""
        self._update()

    def close(self) -> None:
        """End the run, and close what it read."""
        super().close()
        for evaluator in self._evaluators:
            evaluator.close()


def _get_subject(session: Session) -> tuple[object, int]:
    """Return what a grid is of: the recording as it is opened, and the frame, whatever its cells
    try.
    """
    return make_request(replace(session, methods={}, weights={})), session.frame


def _deliver_steps(steps: ComparisonSteps, report: JobReporter) -> Comparison:
    """Deliver every step of a comparison as soon as it is there; returns the last."""
    comparison = Comparison(tiles=(), summary="")
    for comparison in steps(report):
        report.deliver(comparison)
    return comparison
