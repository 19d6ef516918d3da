"""The session and the background work for it: what was asked last is what is shown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import get_args

from PyQt6.QtCore import pyqtSignal

from app.frame.controls import show_controls
from app.frame.logs import LogRelay
from app.frame.screen import Screen
from app.frame.tracing import Tracer
from app.frame.window import Window
from app.session.documents import Documents
from app.session.state import Session
from app.session.undo import sessions_of
from app.work.drawing import SlotShown, SourceShown
from app.work.evaluator import BeginsAt, Evaluator, FrameShown
from app.work.jobs import LatestJob, Work
from app.work.opening import asked_by, place_before, request_of
from pipeline.engine.graph import Method
from pipeline.scoring.beside import Versus
from pipeline.translation.catalogue import BUILT_IN, Catalogue
from pipeline.translation.translate import Request, Translation
from widgets.looks import once

_STALE_AFTER_MS = 150  # a picture that is replaced sooner need not say that it is old
_PATIENCE_MS = 500  # younger work is let through, so that a drag shows something on its way; older work is stopped


class Instrument(Documents):
    """Holds the session, asks the background for it, and passes on what comes back."""

    frame_shown = pyqtSignal(int)
    session_shown = pyqtSignal(object)  # Session
    closing = pyqtSignal()
    ended_from_outside = pyqtSignal()  # before it is closed, and nobody can be asked

    def __init__(self, window: Window, catalogue: Catalogue = BUILT_IN) -> None:
        super().__init__(window, Session())
        self.relay = LogRelay(self)
        self.catalogue = catalogue
        self.job, self.evaluator = LatestJob("stages", self), Evaluator(catalogue)
        self.tracer = Tracer(window)
        self.screen = Screen(window, self.tracer)
        self._ticket = self._wanted_since = self._opening = self._background = 0
        self._closed = self._waits = self._beside = self._owed = False  # owed: stages that were dropped on their way
        self._open: set[Request | None] = {None}  # what is open, as it was asked for and as it is named since
        self._failing: set[Request | None] = set()  # what could not be opened since
        self._passing = False  # over steps of the undo stack that lie on the way
        self.latest: FrameShown | None = None  # the frame on screen
        self._stale, self._young = (
            once(self, _STALE_AFTER_MS, self.screen.mark_stale),
            once(self, _PATIENCE_MS, lambda: None),
        )

    def choose_frame(self, frame: int) -> None:
        """Go to a frame."""
        self.change("go to another frame", key="frame", frame=frame)

    def choose_params(self, key: str, params: object) -> None:
        """Set the parameters of a method or of the display; a drag is one undo step."""
        self.change(f"change {key}", key=f"params {key}", params={**self.session.params, key: params})

    def choose_method(self, slot: str, name: str) -> None:
        """Fill a slot by another method; the route's own is no choice to be kept."""
        others = {s: m for s, m in self.session.methods.items() if s != slot}
        own = self.catalogue.route(self.session.route).methods.get(slot) == name
        self.change(f"choose {name} for {slot}", methods=others if own else {**others, slot: name})

    def show_session(self, session: Session) -> None:
        """Show a session: controls at once, stages when the background has them."""
        if self._passing:
            return
        old, self.session = self.session, session
        if session.layout != self.window.layout_shown:
            self.window.show_layout(session.layout)
        self._show_controls()
        if session.settings != old.settings:
            self.window.frames.known.forget()
        if session.linked != old.linked or session.display != old.display:
            self.screen.look(session)
        if session.recording is not None:
            self._ask(other_request=old.recording is None or request_of(old) != request_of(session))
        self.session_shown.emit(session)

    @property
    def to_keep(self) -> Session:
        """The session with where the 3D views look, and the section's line."""
        return replace(self.session, cameras=self.screen.cameras.of(self.screen.scene), section=self.section)

    def turn(self, cameras: Mapping[str, tuple[float, ...]]) -> None:
        """Have the 3D views look so, once what the session opens is there."""
        self.screen.cameras.want(cameras, self.screen.scene if self._is_open() and not self._opening else None)

    def compare(self, beside: bool) -> None:
        """Whether to outline what the target really felt."""
        if beside != self._beside:
            self._beside = beside
            self.refresh()

    def show_versus(self, versus: Versus) -> None:
        """What every column shows beside, or in place of, what was worked out."""
        self.screen.versus = versus
        for name in get_args(Versus)[1:]:
            self.window.actions_by_name[f"show_{name}"].setChecked(name == versus)
        self.refresh()

    def refresh(self) -> None:
        """Ask for the session's frame again."""
        if self.session.recording is not None and not self._closed:
            self._ask(other_request=False)

    def ahead(self, work: Work) -> int:
        """Run something brief on the frame at hand in place of its stages; returns its ticket, 0 if none is open.

        Stages that were on their way are dropped: `refresh` asks for them again, and until then it is not idle.
        """
        if self._opening or self._closed or self.screen.opened is None:
            return 0
        owed, interrupt = self._waits or self._owed, self._waits or self.job.newest == self._background
        self._rest()
        self._owed = owed
        self.screen.mark_dropped()
        self._ticket = 0  # what is dropped now is not missed
        self._ticket = self.job.submit(work, interrupt=interrupt)
        return self._ticket

    def background(self, work: Work) -> int:
        """As `ahead`, for what anything else goes before: the instrument counts as idle meanwhile."""
        self._background = self.ahead(work)
        return self._background

    def show_only(self, name: str) -> None:
        """One stage alone, or all again; what is hidden is not worked out."""
        alone = self.window.visible_columns() == (name,)
        self.screen.show_only(None if alone else name)
        self.refresh()

    def reset_view(self) -> None:
        """Look at every 3D view as at first."""
        self.screen.look(self.session)

    def cancel(self) -> None:
        """Stop the work, and take the crosshairs away."""
        self.job.cancel()
        self.tracer.clear()

    def close(self) -> None:
        """Stop the background, then everything OpenGL."""
        if self._closed:
            return
        self._closed = True
        self.undo.blockSignals(True)  # it outlives the actions that listen to it
        self.window.timeline.play(on=False)
        self._stale.stop()
        self.closing.emit()
        self.job.close()
        self.evaluator.close()
        self.screen.finish()
        self.relay.close()

    @property
    def closed(self) -> bool:
        """Whether nothing is worked out any more."""
        return self._closed

    @property
    def idle(self) -> bool:
        """Whether everything asked for is on screen, or has failed."""
        busy = self.job.busy and self.job.newest != self._background
        return not (busy or self._stale.isActive() or self._waits or self._owed)

    def take_part(self, ticket: int, part: object) -> None:
        """Show a part of the result; parts for another recording come too late."""
        if ticket < self._wanted_since or self._closed:
            return
        self._opening = 0
        if isinstance(part, BeginsAt):
            self.session = replace(self.session, frame=part.index)
            self._show_controls()
        elif isinstance(part, Translation) and part is not self.screen.opened:
            named = replace(self.session, target=part.target.name, frame=min(self.session.frame, part.n_frames - 1))
            seen = set(self.window.visible_columns())
            self._open, self._failing = {request_of(self.session), request_of(named)}, set()
            self.session = named
            self.screen.show_opened(part, named)
            self._show_controls()
            if not seen.issuperset(self.window.visible_columns()):
                self.refresh()  # the route has columns that were not seen when it, or a frame since, was asked for
        elif isinstance(part, SourceShown | SlotShown):
            self.screen.show_part(part, newest=ticket == self._ticket)
            if isinstance(part, SourceShown):
                self.window.timeline.show_frame(self.session.frame, part.frame.time_s)
        if ticket == self._ticket:
            self.screen.mark_running()

    def take_frame(self, ticket: int, shown: object) -> None:
        """Show what belongs to a whole frame."""
        if ticket < self._wanted_since or self._closed or not isinstance(shown, FrameShown):
            return
        self.latest = shown
        self.screen.show_frame(shown, comparable=shown.settings == self.session.settings)
        if ticket == self._ticket:
            self._rest()
            self.frame_shown.emit(shown.index)

    def take_failure(self, ticket: int, error: object) -> None:
        """Say what went wrong; what could not be opened is undone, so that what was open stays usable."""
        if ticket < self._wanted_since or self._closed or not isinstance(error, BaseException):
            return
        if ticket == self._ticket:
            not_opened = self._opening == ticket and not self._is_open()  # a frame of what is open may be damaged
            self._rest()
            if not_opened:
                self._take_back()
            else:
                self.screen.mark_failed(error)
        self.show_problem(error)

    def take_cancel(self, ticket: int) -> None:
        """Nothing more will come for this ticket."""
        if ticket == self._ticket and not self._closed:
            self.screen.mark_cancelled()
            self._rest()

    def take_progress(self, ticket: int, fraction: float, text: str) -> None:
        """Show how far the newest work is."""
        if ticket == self._ticket and self._waits:
            self.window.show_progress(fraction, text)

    def _take_back(self) -> None:
        """Go back to a session that is open, or may be, but stay on the frame that was chosen meanwhile."""
        failed, known = self.session, sessions_of(self.undo)
        self._failing.add(asked_by(failed))
        place = place_before(known, self.undo.index(), self._open, self._failing)
        if place is None:
            self.screen.mark_cancelled()
            return
        self._passing = True  # what lies between is not asked for
        self.undo.setIndex(place)
        self._passing = False
        self.show_session(known[place])
        if self.session.recording == failed.recording:
            self.choose_frame(failed.frame)

    def _is_open(self) -> bool:
        return asked_by(self.session) in self._open

    @property
    def methods(self) -> tuple[Method, ...]:
        """Those of the session's route, one a slot."""
        return self.catalogue.methods(self.session.route, self.session.methods)

    @property
    def kinds(self) -> Mapping[str, str]:
        """Key of a method -> the kind of sensor that it looks at; nothing where nothing is open."""
        opened = self.screen.opened
        if opened is None:
            return {}
        kind = {"source": opened.source.kind, "target": opened.target.kind}
        return {method.key: kind[self.catalogue.slot(method.slot).place] for method in self.methods}

    def _show_controls(self) -> None:
        show_controls(self.window, self.session, self.methods, self.catalogue, self.kinds)

    def _ask(self, *, other_request: bool) -> None:
        session, wanted = self._drafted(), self.window.visible_columns()
        show = partial(
            self.evaluator.show, compared=self._beside, seen=lambda: self.screen.opened,
            with_truth=bool(self.screen.versus) or session.layout.name == "demo",
        )  # fmt: skip
        interrupt = other_request or not self._young.isActive()
        self._waits, self._owed = True, False
        self._ticket = 0  # what is dropped now is not missed
        self._ticket = self.job.submit(lambda report: show(session, wanted, report), interrupt=interrupt)
        if other_request:
            self._wanted_since = self._ticket
        if other_request or self._opening:
            self._opening = self._ticket
        if interrupt:
            self._young.start()
        self.screen.expect_all()
        self.window.timeline.show_ready(ready=False)
        if not self._stale.isActive():
            self._stale.start()

    def _drafted(self) -> Session:
        """The session, or while a parameter is dragged one that is quick to show from there on."""
        methods, dragged = self.methods, self.window.parameters.dragged
        first = next((i for i, method in enumerate(methods) if method.key == dragged), len(methods))
        return self.session.drafted(methods[first:])

    def _rest(self, *, owed: bool = False) -> None:
        self._waits, self._owed = False, owed
        self._opening = 0
        self._stale.stop()
        self._young.stop()
        self.window.show_progress(None)
        self.window.timeline.show_ready(ready=True)
