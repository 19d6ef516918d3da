"""*Compare* at work: the frame on screen several ways, in a thread of its own, while somebody looks."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from PyQt6.QtCore import QObject

from app.frame.instrument import Instrument
from app.session.layout import Layout
from app.session.state import Session
from app.work import side_by_side
from app.work.evaluator import Evaluator, request_of
from app.work.jobs import LatestJob, Report
from app.work.side_by_side import Tiles
from pipeline.base.errors import TouchError
from pipeline.scoring.versions import Kept

Work = Callable[[Report], Tiles]


class Comparing(QObject):
    """Between the page and the instrument; nothing is worked out for a tab that nobody sees."""

    def __init__(self, instrument: Instrument) -> None:
        super().__init__(instrument)
        self._instrument, self._page = instrument, instrument.window.compare
        self._job = LatestJob("compare", self)
        self._own, self._kept = Evaluator(instrument.catalogue), Kept()
        self._asked: tuple[object, ...] = ()
        self._ticket = 0
        self._works: Mapping[str, Callable[[Session], Work]] = {"methods": self._by_method}
        page, job = self._page, self._job
        page.tab_chosen.connect(self._ask)
        page.choice_changed.connect(self._ask)
        for tab in page.tabs.values():
            tab.cancel_wanted.connect(job.cancel)
            tab.grid.pointed.connect(instrument.window.probe.setText)
        job.delivered.connect(self._take)
        job.finished.connect(self._finished)
        job.failed.connect(self._failed)
        job.cancelled.connect(self._cancelled)
        job.progressed.connect(self._progressed)
        instrument.frame_shown.connect(self._frame_shown)
        instrument.session_shown.connect(self._session_shown)
        instrument.closing.connect(self._close)
        instrument.window.on("cancel", job.cancel)
        instrument.window.on("reset_view", self._fit)

    def _fit(self) -> None:
        self._page.tab.grid.reset_view()

    @property
    def busy(self) -> bool:
        """Whether tiles are still to come."""
        return self._job.busy

    def _by_method(self, session: Session) -> Work:
        order = self._page.order.currentText()
        return lambda report: side_by_side.by_method(self._own, session, order, self._kept, report)

    def _choices(self) -> tuple[object, ...]:
        """What a tab's controls say."""
        return (self._page.name, self._page.order.currentText())

    def _session_shown(self, session: Session) -> None:
        """Whoever looks elsewhere wants nothing of this."""
        if session.layout.name != "compare" or session.recording is None:
            self._job.cancel()
            self._asked = ()

    def _frame_shown(self, _: int) -> None:
        self._ask()

    def _ask(self) -> None:
        """Work the tab in front out, unless that is what it shows."""
        instrument, page = self._instrument, self._page
        session = instrument.session
        if session.layout.name != "compare" or instrument.screen.opened is None or instrument.closed:
            return
        for tab in page.tabs.values():
            tab.grid.show_versus(instrument.screen.versus)
        asked = (*self._choices(), session.updated(layout=Layout(), linked=True))
        if asked == self._asked:
            return
        old = self._asked[-1] if self._asked else None
        # The next frame waits for the one that is worked out, so that playing shows something on its way.
        same = isinstance(old, Session) and request_of(old) == request_of(session) and asked[:-1] == self._asked[:-1]
        self._asked = asked
        page.tab.show_progress(0.0)
        self._ticket = self._job.submit(self._works[page.name](session), interrupt=not same)

    def _take(self, ticket: int, part: object) -> None:
        if isinstance(part, Tiles) and ticket == self._ticket:
            self._show(part)

    def _show(self, shown: Tiles) -> None:
        with self._instrument.watch.timed("Tiles"):
            self._page.tab.grid.show_tiles(shown.tiles)
            self._page.tab.told.setText(shown.told)

    def _finished(self, ticket: int, shown: object) -> None:
        if isinstance(shown, Tiles) and self._asked:
            self._show(shown)
        if ticket == self._ticket:
            self._rest()

    def _failed(self, ticket: int, error: object) -> None:
        if ticket != self._ticket or not isinstance(error, BaseException):
            return
        self._rest()
        self._page.tab.grid.show_tiles(())
        self._page.tab.told.setText(str(error))
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
        self._job.close()
        self._own.close()
