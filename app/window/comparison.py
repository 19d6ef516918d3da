"""*Compare* at work: the frame on screen several ways, in a thread of its own, while somebody looks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import cast

from PyQt6.QtCore import QObject

from app.session.comparison_settings import LAST_STAGE, ComparisonSettings, ComparisonTabName
from app.session.differences import describe_differences
from app.session.layout import Layout
from app.session.state import Session
from app.window.session_controller import SessionController
from app.work.evaluator import Evaluator
from app.work.jobs import JobReporter, LatestJob
from app.work.requests import make_request
from app.work.variants import compare_variants
from pipeline.base.allocator import release_free_memory
from pipeline.base.errors import TouchError
from pipeline.evaluation.comparison_tiles import ComparisonTiles
from pipeline.evaluation.method_comparison import compare_methods
from pipeline.evaluation.method_results import MethodCache
from pipeline.evaluation.seed_sweep import sweep_seeds
from pipeline.networks import network_factory
from widgets.styling import make_single_shot_timer

TilesJob = Callable[[JobReporter], ComparisonTiles]
_NO_OTHER = "hold these settings and change some, or choose another recording: both are shown on the same frame"
_NOT_DRAWN = "Draw makes this frame's touch with several seeds: how far they spread tells luck from bias"
_LETS_GO_MS = 20_000  # after somebody went elsewhere: who comes back sooner finds all as it was
_SAME = "no setting differs yet: what is changed from now on is A's (F3 has the parameters)"


class ComparisonController(QObject):
    """Between the page and the instrument; nothing is worked out for a tab that nobody sees."""

    def __init__(self, instrument: SessionController) -> None:
        super().__init__(instrument)
        self._instrument, self._page = instrument, instrument.window.comparison
        self._job = LatestJob("compare", self)
        self._own, self._kept = Evaluator(instrument.catalogue, like=instrument.evaluator), MethodCache()
        self._other = Evaluator(instrument.catalogue, like=instrument.evaluator)
        self._asked: tuple[object, ...] = ()
        self._ticket, self._since, self._drawn = 0, 0, False
        self._away = make_single_shot_timer(self, _LETS_GO_MS, self.release_memory)
        self._looked = False  # at this, by whoever sees the window
        self._shown = (ComparisonSettings(), None)  # what was chosen when it was looked at last
        self._works: Mapping[str, Callable[[Session], TilesJob | str]] = {
            "methods": self._by_method, "two": self._two, "seeds": self._seeds,
        }  # fmt: skip
        page, job, window = self._page, self._job, instrument.window
        page.tab_chosen.connect(self._choose)
        page.choice_changed.connect(self._choose)
        page.sampling_requested.connect(self._draw)
        for tab in page.tabs.values():
            tab.cancel_requested.connect(job.cancel)
            tab.grid.readout_changed.connect(window.readout.setText)
        job.delivered.connect(self._take)
        job.finished.connect(self._finished)
        job.failed.connect(self._failed)
        job.cancelled.connect(self._cancelled)
        job.progressed.connect(self._progressed)
        instrument.frame_shown.connect(self._frame_shown)
        instrument.session_shown.connect(self._session_shown)
        instrument.closing.connect(self._close)
        window.connect_command("cancel", job.cancel)
        window.connect_command("reset_view", self._fit)
        window.connect_command("set_variant_settings", self.set_variant_settings)
        window.connect_command("clear_variant", self.clear_variant)
        window.actions_by_name["clear_variant"].setEnabled(False)

    @property
    def is_busy(self) -> bool:
        """Whether tiles are still to come."""
        return not self._job.is_settled

    def set_variant_settings(self) -> None:
        """What is set now is B from now on."""
        self._hold(self._instrument.session)

    def set_variant_recording(self, path: Path) -> None:
        """Another recording is B, with what is set now."""
        self._hold(replace(self._instrument.session, recording=path))

    def release_memory(self) -> None:
        """Forget what was worked out here, and networks that no column reads: nobody looks at what takes most room."""
        if self._looked or self._instrument.is_closed:
            return
        if self._job.is_busy:  # it was told to stop
            self._away.start()
            return
        self._kept.clear()
        for evaluator in (self._own, self._other):
            evaluator.release_caches()
        network_factory.release_networks(self._instrument.evaluator.weights_in_use)
        self._job.submit(lambda _: release_free_memory())

    def _choose(self) -> None:
        """What the page says is the session's."""
        page, old = self._page, self._instrument.session.comparison
        slot = old.stage if page.stage_box.currentIndex() < 0 else str(page.stage_box.currentData())
        if old.stage == LAST_STAGE and page.stage_box.currentIndex() == page.stage_box.count() - 1:
            slot = LAST_STAGE
        new = ComparisonSettings(
            tab=cast("ComparisonTabName", page.current_name),
            order=page.order_box.currentText(),
            stage=slot,
            seeds=page.seed_count_box.value(),
        )
        self._instrument.change("choose in Compare", key="seeds" if new.seeds != old.seeds else "", comparison=new)

    def clear_variant(self) -> None:
        """There is no B any more."""
        self._hold(None)

    def _hold(self, session: Session | None) -> None:
        now = self._instrument.session
        if session is None:
            self._instrument.change("let B go", variant=None)
        elif now.recording is not None:
            self._instrument.change(
                "hold B", variant=replace(session, variant=None), comparison=replace(now.comparison, tab="two"),
                layout=replace(now.layout, name="compare"),
            )  # fmt: skip

    def _by_method(self, session: Session) -> TilesJob:
        def work(report: JobReporter) -> ComparisonTiles:
            translation, frame = self._own.open_frame(session, report)
            order, kept = session.comparison.order, self._kept
            return compare_methods(
                translation, frame, session.params, session.display, order, kept, hand_over=report.deliver,
                progress=report,
            )  # fmt: skip

        return work

    def _two(self, session: Session) -> TilesJob | str:
        if session.variant is None:
            return _NO_OTHER
        other = replace(
            session.variant, frame=session.frame, params={**session.variant.params, "display": session.display}
        )
        slot = str(self._page.stage_box.currentData() or "")
        told = "; ".join(describe_differences(session, other, self._instrument.catalogue)) or _SAME
        both, sessions = (self._own, self._other), (session, other)
        return lambda report: compare_variants(both, sessions, slot, told, report)

    def _seeds(self, session: Session) -> TilesJob | str:
        if not self._drawn:
            return _NOT_DRAWN
        self._drawn = False

        def work(report: JobReporter) -> ComparisonTiles:
            translation, frame = self._own.open_frame(session, report)
            count = session.comparison.seeds
            return sweep_seeds(
                translation, frame, session.params, session.display, count, self._own.graph,
                hand_over=report.deliver, progress=report,
            )  # fmt: skip

        return work

    def _draw(self) -> None:
        self._drawn, self._asked = True, ()
        self._ask()

    def _choices(self) -> tuple[object, ...]:
        """What the controls of the tab in front say."""
        page, session = self._page, self._instrument.session
        own = {"methods": session.comparison.order, "two": (page.stage_box.currentData(), session.variant)}
        return (page.current_name, own.get(page.current_name))

    def _frame_shown(self, _: int) -> None:
        self._ask()

    def _fit(self) -> None:
        self._page.current_tab.grid.reset_view()

    def _session_shown(self, session: Session) -> None:
        """Whoever looks elsewhere wants nothing of this."""
        looked, self._looked = self._looked, session.layout.name == "compare"
        if self._looked:
            self._away.stop()
        elif looked:
            self._away.start()
        if not self._looked or session.recording is None:
            self._job.cancel()
            self._asked = ()
        self._show_choices(session)
        if (session.comparison, session.variant) != self._shown:
            self._shown = (session.comparison, session.variant)
            self._ask()

    def _show_choices(self, session: Session) -> None:
        chosen = session.comparison
        self._page.show_choices(chosen.tab, chosen.order, chosen.stage, chosen.seeds)
        self._instrument.window.actions_by_name["clear_variant"].setEnabled(session.variant is not None)

    def _ask(self) -> None:
        """Work the tab in front out, unless that is what it shows."""
        instrument, page = self._instrument, self._page
        session, opened = instrument.session, instrument.views.translation
        if session.layout.name != "compare" or opened is None or instrument.is_closed:
            return
        page.offer_stages({name: opened.catalogue.stage(name).title for name in opened.stages})
        self._show_choices(session)
        for tab in page.tabs.values():
            tab.grid.set_comparison_mode(instrument.views.comparison_mode)
        asked = (
            *self._choices(),
            session.with_updates(layout=Layout(), cameras_linked=True, comparison=ComparisonSettings(), variant=None),
        )
        if asked == self._asked:
            return
        old = self._asked[-1] if self._asked else None
        # The next frame waits for the one that is worked out, so that playing shows something on its way.
        same = (
            isinstance(old, Session) and make_request(old) == make_request(session) and asked[:-1] == self._asked[:-1]
        )
        self._asked = asked
        work = self._works[page.current_name](session)
        if isinstance(work, str):
            self._job.cancel()
            self._ticket = self._since = self._job.newest_ticket + 1  # what is on its way is for another tab
            self._rest()
            self._show(ComparisonTiles(tiles=(), summary=work))
            return
        page.current_tab.show_progress(0.0)
        self._ticket = self._job.submit(work, interrupt=not same)
        self._since = self._since if same else self._ticket

    def _take(self, ticket: int, part: object) -> None:
        if isinstance(part, ComparisonTiles) and ticket == self._ticket:
            self._show(part)

    def _show(self, shown: ComparisonTiles) -> None:
        page = self._page
        page.current_tab.grid.show_tiles(shown.tiles)
        page.current_tab.message.setText(shown.summary)
        if page.current_name == "seeds":
            page.plot.show_points(shown.reliability_curve)
        if page.current_name == "two":
            page.show_3d_views(bool(shown.views_3d))
            for letter, cell in zip("AB", page.views_3d if shown.views_3d else (), strict=False):
                cell.legend.setText(f"{letter} · {self._instrument.catalogue.stage(shown.stage).legend}")
            self._instrument.views.show_variants(shown.stage, shown.views_3d, self._instrument.session)

    def _finished(self, ticket: int, shown: object) -> None:
        if isinstance(shown, ComparisonTiles) and self._asked and ticket >= self._since:
            self._show(shown)
        if ticket == self._ticket:
            self._rest()

    def _failed(self, ticket: int, error: object) -> None:
        if ticket != self._ticket or not isinstance(error, BaseException):
            return
        self._rest()
        self._show(ComparisonTiles(tiles=(), summary=str(error)))
        if not isinstance(error, TouchError):
            self._instrument.show_problem(error)

    def _cancelled(self, ticket: int) -> None:
        if ticket == self._ticket and self._asked:
            self._rest()
            self._page.current_tab.message.setText(f"stopped; {self._page.current_tab.message.text()}")

    def _progressed(self, ticket: int, fraction: float, _: str) -> None:
        if ticket == self._ticket and self._job.is_busy:
            self._page.current_tab.show_progress(fraction)

    def _rest(self) -> None:
        for tab in self._page.tabs.values():
            tab.show_progress(None)

    def _close(self) -> None:
        self._away.stop()
        self._job.close()
        for evaluator in (self._own, self._other):
            evaluator.close()
