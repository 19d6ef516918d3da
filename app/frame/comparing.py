"""*Compare* at work: the frame on screen several ways, in a thread of its own, while somebody looks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import cast

from PyQt6.QtCore import QObject

from app.frame.instrument import Instrument
from app.session.compared import LAST_SLOT, Compared, CompareTab
from app.session.differences import differences
from app.session.layout import Layout
from app.session.state import Session
from app.work.evaluator import Evaluator
from app.work.jobs import LatestJob, Report
from app.work.opening import request_of
from app.work.two_at_once import two_at_once
from pipeline.base.allocator import give_back
from pipeline.base.errors import TouchError
from pipeline.networks import building
from pipeline.scoring.by_seed import by_seed
from pipeline.scoring.side_by_side import by_method
from pipeline.scoring.tiles import Tiles
from pipeline.scoring.versions import Kept
from widgets.looks import once

Work = Callable[[Report], Tiles]
_NO_OTHER = "hold these settings and change some, or choose another recording: both are shown on the same frame"
_NOT_DRAWN = "Draw makes this frame's touch with several seeds: how far they spread tells luck from bias"
_LETS_GO_MS = 20_000  # after somebody went elsewhere: who comes back sooner finds all as it was
_SAME = "no setting differs yet: what is changed from now on is A's (F3 has the parameters)"


class Comparing(QObject):
    """Between the page and the instrument; nothing is worked out for a tab that nobody sees."""

    def __init__(self, instrument: Instrument) -> None:
        super().__init__(instrument)
        self._instrument, self._page = instrument, instrument.window.compare
        self._job = LatestJob("compare", self)
        self._own, self._kept = Evaluator(instrument.catalogue, like=instrument.evaluator), Kept()
        self._other = Evaluator(instrument.catalogue, like=instrument.evaluator)
        self._asked: tuple[object, ...] = ()
        self._ticket, self._since, self._drawn = 0, 0, False
        self._away = once(self, _LETS_GO_MS, self.let_memory_go)
        self._looked = False  # at this, by whoever sees the window
        self._shown = (Compared(), None)  # what was chosen when it was looked at last
        self._works: Mapping[str, Callable[[Session], Work | str]] = {
            "methods": self._by_method, "two": self._two, "seeds": self._seeds,
        }  # fmt: skip
        page, job, window = self._page, self._job, instrument.window
        page.tab_chosen.connect(self._choose)
        page.choice_changed.connect(self._choose)
        page.draw_wanted.connect(self._draw)
        for tab in page.tabs.values():
            tab.cancel_wanted.connect(job.cancel)
            tab.grid.pointed.connect(window.probe.setText)
        job.delivered.connect(self._take)
        job.finished.connect(self._finished)
        job.failed.connect(self._failed)
        job.cancelled.connect(self._cancelled)
        job.progressed.connect(self._progressed)
        instrument.frame_shown.connect(self._frame_shown)
        instrument.session_shown.connect(self._session_shown)
        instrument.closing.connect(self._close)
        window.on("cancel", job.cancel)
        window.on("reset_view", self._fit)
        window.on("hold_settings", self.hold_settings)
        window.on("let_go", self.let_go)
        window.actions_by_name["let_go"].setEnabled(False)

    @property
    def busy(self) -> bool:
        """Whether tiles are still to come."""
        return not self._job.quiet

    def hold_settings(self) -> None:
        """What is set now is B from now on."""
        self._hold(self._instrument.session)

    def hold_recording(self, path: Path) -> None:
        """Another recording is B, with what is set now."""
        self._hold(replace(self._instrument.session, recording=path))

    def let_memory_go(self) -> None:
        """Forget what was worked out here, and networks that no column reads: nobody looks at what takes most room."""
        if self._looked or self._instrument.closed:
            return
        if self._job.busy:  # it was told to stop
            self._away.start()
            return
        self._kept.let_go()
        for evaluator in (self._own, self._other):
            evaluator.let_go()
        building.let_go(self._instrument.evaluator.weights_in_use)
        self._job.submit(lambda _: give_back())

    def _choose(self) -> None:
        """What the page says is the session's."""
        page, old = self._page, self._instrument.session.compared
        slot = old.slot if page.slot.currentIndex() < 0 else str(page.slot.currentData())
        if old.slot == LAST_SLOT and page.slot.currentIndex() == page.slot.count() - 1:
            slot = LAST_SLOT
        new = Compared(
            tab=cast("CompareTab", page.name), order=page.order.currentText(), slot=slot, seeds=page.count.value()
        )
        self._instrument.change("choose in Compare", key="seeds" if new.seeds != old.seeds else "", compared=new)

    def let_go(self) -> None:
        """There is no B any more."""
        self._hold(None)

    def _hold(self, session: Session | None) -> None:
        now = self._instrument.session
        if session is None:
            self._instrument.change("let B go", held=None)
        elif now.recording is not None:
            self._instrument.change(
                "hold B", held=replace(session, held=None), compared=replace(now.compared, tab="two"),
                layout=replace(now.layout, name="compare"),
            )  # fmt: skip

    def _by_method(self, session: Session) -> Work:
        def work(report: Report) -> Tiles:
            translation, frame = self._own.at(session, report)
            order, kept = session.compared.order, self._kept
            return by_method(
                translation, frame, session.params, session.display, order, kept, hand_over=report.hand_over,
                progress=report,
            )  # fmt: skip

        return work

    def _two(self, session: Session) -> Work | str:
        if session.held is None:
            return _NO_OTHER
        other = replace(session.held, frame=session.frame, params={**session.held.params, "display": session.display})
        slot = str(self._page.slot.currentData() or "")
        told = "; ".join(differences(session, other, self._instrument.catalogue)) or _SAME
        both, sessions = (self._own, self._other), (session, other)
        return lambda report: two_at_once(both, sessions, slot, told, report)

    def _seeds(self, session: Session) -> Work | str:
        if not self._drawn:
            return _NOT_DRAWN
        self._drawn = False

        def work(report: Report) -> Tiles:
            translation, frame = self._own.at(session, report)
            count = session.compared.seeds
            return by_seed(
                translation, frame, session.params, session.display, count, self._own.graph,
                hand_over=report.hand_over, progress=report,
            )  # fmt: skip

        return work

    def _draw(self) -> None:
        self._drawn, self._asked = True, ()
        self._ask()

    def _choices(self) -> tuple[object, ...]:
        """What the controls of the tab in front say."""
        page, session = self._page, self._instrument.session
        own = {"methods": session.compared.order, "two": (page.slot.currentData(), session.held)}
        return (page.name, own.get(page.name))

    def _frame_shown(self, _: int) -> None:
        self._ask()

    def _fit(self) -> None:
        self._page.tab.grid.reset_view()

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
        if (session.compared, session.held) != self._shown:
            self._shown = (session.compared, session.held)
            self._ask()

    def _show_choices(self, session: Session) -> None:
        chosen = session.compared
        self._page.show_choices(chosen.tab, chosen.order, chosen.slot, chosen.seeds)
        self._instrument.window.actions_by_name["let_go"].setEnabled(session.held is not None)

    def _ask(self) -> None:
        """Work the tab in front out, unless that is what it shows."""
        instrument, page = self._instrument, self._page
        session, opened = instrument.session, instrument.screen.opened
        if session.layout.name != "compare" or opened is None or instrument.closed:
            return
        page.offer_slots({name: opened.catalogue.slot(name).title for name in opened.slots})
        self._show_choices(session)
        for tab in page.tabs.values():
            tab.grid.show_versus(instrument.screen.versus)
        asked = (*self._choices(), session.updated(layout=Layout(), linked=True, compared=Compared(), held=None))
        if asked == self._asked:
            return
        old = self._asked[-1] if self._asked else None
        # The next frame waits for the one that is worked out, so that playing shows something on its way.
        same = isinstance(old, Session) and request_of(old) == request_of(session) and asked[:-1] == self._asked[:-1]
        self._asked = asked
        work = self._works[page.name](session)
        if isinstance(work, str):
            self._job.cancel()
            self._ticket = self._since = self._job.newest + 1  # what is on its way is for another tab
            self._rest()
            self._show(Tiles(tiles=(), told=work))
            return
        page.tab.show_progress(0.0)
        self._ticket = self._job.submit(work, interrupt=not same)
        self._since = self._since if same else self._ticket

    def _take(self, ticket: int, part: object) -> None:
        if isinstance(part, Tiles) and ticket == self._ticket:
            self._show(part)

    def _show(self, shown: Tiles) -> None:
        page = self._page
        page.tab.grid.show_tiles(shown.tiles)
        page.tab.told.setText(shown.told)
        if page.name == "seeds":
            page.plot.show_points(shown.curve)
        if page.name == "two":
            page.show_solids(bool(shown.solids))
            for letter, cell in zip("AB", page.solids if shown.solids else (), strict=False):
                cell.legend.setText(f"{letter} · {self._instrument.catalogue.slot(shown.slot).legend}")
            self._instrument.screen.show_others(shown.slot, shown.solids, self._instrument.session)

    def _finished(self, ticket: int, shown: object) -> None:
        if isinstance(shown, Tiles) and self._asked and ticket >= self._since:
            self._show(shown)
        if ticket == self._ticket:
            self._rest()

    def _failed(self, ticket: int, error: object) -> None:
        if ticket != self._ticket or not isinstance(error, BaseException):
            return
        self._rest()
        self._show(Tiles(tiles=(), told=str(error)))
        if not isinstance(error, TouchError):
            self._instrument.show_problem(error)

    def _cancelled(self, ticket: int) -> None:
        if ticket == self._ticket and self._asked:
            self._rest()
            self._page.tab.told.setText(f"stopped; {self._page.tab.told.text()}")

    def _progressed(self, ticket: int, fraction: float, _: str) -> None:
        if ticket == self._ticket and self._job.busy:
            self._page.tab.show_progress(fraction)

    def _rest(self) -> None:
        for tab in self._page.tabs.values():
            tab.show_progress(None)

    def _close(self) -> None:
        self._away.stop()
        self._job.close()
        for evaluator in (self._own, self._other):
            evaluator.close()
