"""*Compare*: computes variants of the current frame in a thread of its own while the page is
visible.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import cast

from app.compare.variant_jobs import (
    describe_differences,
    format_compare_command,
    label_axes,
    list_axes,
    open_variant,
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
        self._builders: Mapping[str, Callable[[Session], ComparisonSteps | str]] = {
            "methods": self._build_methods,
            "two": self._build_pair,
        }
        window = controller.window
        page.choice_changed.connect(self._choose)
        page.grid.start_button.clicked.connect(self._start_grid)
        page.grid.grid.cell_chosen.connect(self._use_cell)
        for tab in page.tile_tabs:
            tab.grid.readout_changed.connect(window.show_pixel)
        controller.frame_shown.connect(self._update)
        controller.closing.connect(self._close)
        window.connect_command("cancel", self.cancel)
        window.connect_command("reset_view", self._reset_view)
        window.connect_command("set_variant_settings", self.set_variant_settings)
        window.connect_command("clear_variant", self.clear_variant)
        window.actions_by_name["clear_variant"].setEnabled(False)

    def set_variant_settings(self) -> None:
        """Hold the current settings as variant B."""
        self._set_variant(self._controller.session)

    def set_variant_recording(self, path: Path) -> None:
        """Hold another recording with the current settings as variant B."""
        self._set_variant(self._controller.session.with_updates(recording=path))

    def clear_variant(self) -> None:
        """Remove variant B."""
        self._controller.change("clear B", variant=None)

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
        now = self._controller.session
        if now.recording is not None:
            self._controller.change(
                "keep as B",
                variant=replace(session, variant=None),
                comparison=replace(now.comparison, tab="two"),
                layout=replace(now.layout, name="compare"),
            )

    def _choose(self) -> None:
        """Store the page's choices in the session."""
        page = self._page
        session = self._controller.session
        old = session.comparison
        stage = old.stage if page.stage_box.currentIndex() < 0 else page.stage_box.choice
        if old.stage == LAST_STAGE and page.stage_box.currentIndex() == page.stage_box.count() - 1:
            stage = LAST_STAGE
        new = ComparisonSettings(
            tab=cast("ComparisonTabName", page.current_name),
            order=page.order_box.choice,
            stage=stage,
        )
        self._controller.change("choose in Compare", comparison=new)

    def _build_methods(self, session: Session) -> ComparisonSteps:
        def run(report: JobReporter) -> Iterator[Comparison]:
            variant, frame = open_variant("", self._evaluators[0], session, report)
            order = session.comparison.order
            display = session.display
            return compare_methods(
                self._method_runner,
                variant.translation,
                frame,
                session.params,
                display,
                order,
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
        opened = self._controller.views.translation
        has_mesh = opened is not None and opened.mesh is not None
        differences = describe_differences(
            session, other, self._controller.catalogue, has_mesh=has_mesh
        )
        differs = "; ".join(differences) or _NO_DIFFERENCE

        def run(report: JobReporter) -> Iterator[Comparison]:
            first, frame = open_variant("A", self._evaluators[0], session, report)

            def open_second() -> Variant:
                return open_variant("B", self._evaluators[1], other, report)[0]

            return compare_pair(
                self._shared_runner,
                first,
                open_second,
                frame,
                session.display,
                stage,
                differs,
                report,
                second_may_fail=True,
            )

        return run

    def _parse_plan(self) -> GridPlan:
        """Return the plan of the grid's controls; raises SettingProblem."""
        opened = self._controller.views.translation
        tab = self._page.grid
        if opened is None:
            raise SettingProblem("there is nothing to compare; open a recording first")
        base = Variant(label="", translation=opened, params=self._controller.session.params)
        across, down = tab.axis_texts
        rows = parse_axis(base, down) if down else None
        return GridPlan(across=parse_axis(base, across), down=rows, metric=tab.metric_box.choice)

    def _start_grid(self) -> None:
        session = self._controller.session
        tab = self._page.grid
        try:
            plan = self._parse_plan()
        except TouchError as error:
            tab.message.setText(str(error))
            return
        self._grid = session, plan
        tab.show_plan(plan, METRICS[plan.metric.partition(".")[2]].unit if plan.metric else "")

        def run(report: JobReporter) -> Iterator[Comparison]:
            variant, frame = open_variant("", self._evaluators[0], session, report)
            return compare_grid(
                self._method_runner,
                variant.translation,
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
        axes = list_axes(session, controller.methods, controller.catalogue, controller.sensor_kinds)
        known = dict.fromkeys((DEFAULT_METRIC, *controller.window.frames.model.metrics))
        metrics = {name: describe_metric(name) for name in known if is_stage_error(name)}
        metric = tab.metric_box.choice if tab.metric_box.count() else DEFAULT_METRIC
        labels = label_axes(axes, controller.methods, controller.catalogue)
        tab.offer_axes(axes, {**metrics, "": "time only"}, metric, labels)
        if self._grid is not None and _get_subject(self._grid[0]) != _get_subject(session):
            self.abandon()
            self._grid = None
            tab.show_plan(None)
            tab.message.setText(GRID_HINT)

    def _use_cell(self, row: int, col: int) -> None:
        """Use a cell's values in the session, as one change."""
        opened = self._controller.views.translation
        if self._grid is None or opened is None:
            return
        base = Variant(label="", translation=opened, params=self._controller.session.params)
        try:
            variant = self._grid[1].build_variant(base, row, col)
        except TouchError as error:
            self._page.grid.message.setText(str(error))
            return
        request = variant.translation.request
        self._controller.change(
            "use a cell of the grid",
            params=variant.params,
            methods=dict(request.methods),
            weights=dict(request.weights),
        )
        self._page.grid.grid.setCurrentCell(row, col)

    def format_command(self, opened: Translation, out: Path) -> str:
        """Return the command that writes what the page shows; raises SettingProblem."""
        session = self._controller.session
        plan = None
        if session.comparison.tab == "grid":
            session, plan = self._grid or (session, self._parse_plan())
        elif session.comparison.tab == "two" and session.variant is None:
            raise SettingProblem(_NO_VARIANT)
        return format_compare_command(session, opened.stages[-1], opened.target.name, out, plan)

    def _get_choices(self) -> tuple[object, ...]:
        """The choices of the current tab."""
        page = self._page
        session = self._controller.session
        choices = {
            "methods": session.comparison.order,
            "two": (page.stage_box.choice, session.variant),
        }
        return (page.current_name, choices.get(page.current_name))

    def show_session(self, session: Session) -> None:
        """Cancel what is no longer visible, and update what is."""
        was_visible = self._is_visible
        self._is_visible = session.layout.name == "compare"
        if self._is_visible:
            self._release_timer.stop()
        elif was_visible:
            self._release_timer.start()
        is_closed = self._controller.views.translation is None
        if is_closed:  # nothing of the recording before stays, if the next one does not open
            for tab in self._page.tile_tabs:
                tab.show_comparison(Comparison(tiles=(), summary=""))
        if session.layout.name != "compare" or is_closed:
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
        self._window.actions_by_name["clear_variant"].setEnabled(session.variant is not None)

    def _update(self, *_: object) -> None:
        """Compute the current tab, unless it shows that already."""
        controller = self._controller
        page = self._page
        session = controller.session
        opened = controller.views.translation
        if session.layout.name != "compare" or opened is None or controller.is_closed:
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
            tab.grid.set_comparison_mode(controller.views.comparison_mode)
        settings = session.with_updates(
            layout=Layout(), cameras_linked=True, comparison=ComparisonSettings(), variant=None
        )
        requested = (*self._get_choices(), settings)
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
        steps = self._builders[page.current_name](session)
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

    def _close(self) -> None:
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
