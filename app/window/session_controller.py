"""The session and the background work for it: what was asked last is what is shown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import get_args

from PyQt6.QtCore import pyqtSignal

from app.session.state import Session
from app.session.undo import list_sessions
from app.window.controls import show_controls
from app.window.logs import LogRelay
from app.window.main_window import MainWindow
from app.window.pixel_trace import PixelProbe
from app.window.session_document import SessionDocument
from app.window.stage_views import StageViews
from app.work.evaluator import EvaluatedFrame, Evaluator, InitialFrame
from app.work.jobs import JobFunction, LatestJob
from app.work.requests import find_undo_target, make_request, make_request_if_open
from app.work.stage_previews import SourcePreview, StagePreview
from pipeline.engine.graph import Method
from pipeline.evaluation.truth_view import ComparisonMode
from pipeline.translation.catalogue import BUILT_IN, Catalogue
from pipeline.translation.translate import Request, Translation
from widgets.styling import make_single_shot_timer

_STALE_AFTER_MS = 150  # a picture that is replaced sooner need not say that it is old
_PATIENCE_MS = 500  # younger work is let through, so that a drag shows something on its way; older work is stopped


class SessionController(SessionDocument):
    """Holds the session, asks the background for it, and passes on what comes back."""

    frame_shown = pyqtSignal(int)
    session_shown = pyqtSignal(object)  # Session
    closing = pyqtSignal()
    termination_requested = pyqtSignal()  # before it is closed, and nobody can be asked

    def __init__(self, window: MainWindow, catalogue: Catalogue = BUILT_IN) -> None:
        super().__init__(window, Session())
        self.relay = LogRelay(self)
        self.catalogue = catalogue
        self.job, self.evaluator = LatestJob("stages", self), Evaluator(catalogue)
        self.probe = PixelProbe(window)
        self.views = StageViews(window, self.probe)
        self._ticket = self._wanted_since = self._opening = self._background = 0
        self._closed = self._waits = self._beside = self._owed = False  # owed: stages that were dropped on their way
        self._open: set[Request | None] = {None}  # what is open, as it was asked for and as it is named since
        self._failing: set[Request | None] = set()  # what could not be opened since
        self._passing = False  # over steps of the undo stack that lie on the way
        self.latest_frame: EvaluatedFrame | None = None  # the frame on screen
        self._stale, self._young = (
            make_single_shot_timer(self, _STALE_AFTER_MS, self.views.mark_stale),
            make_single_shot_timer(self, _PATIENCE_MS, lambda: None),
        )

    def choose_frame(self, frame: int) -> None:
        """Go to a frame."""
        self.change("go to another frame", key="frame", frame=frame)

    def choose_params(self, key: str, params: object) -> None:
        """Set the parameters of a method or of the display; a drag is one undo step."""
        self.change(f"change {key}", key=f"params {key}", params={**self.session.params, key: params})

    def choose_method(self, stage: str, name: str) -> None:
        """Fill a slot by another method; the route's own is no choice to be kept."""
        others = {s: m for s, m in self.session.methods.items() if s != stage}
        own = self.catalogue.route(self.session.route).methods.get(stage) == name
        self.change(f"choose {name} for {stage}", methods=others if own else {**others, stage: name})

    def show_session(self, session: Session) -> None:
        """Show a session: controls at once, stages when the background has them."""
        if self._passing:
            return
        old, self.session = self.session, session
        if session.layout != self.window.current_layout:
            self.window.show_layout(session.layout)
        self._show_controls()
        if session.settings != old.settings:
            self.window.frames.model.clear_summaries()
        if session.cameras_linked != old.cameras_linked or session.display != old.display:
            self.views.reset_cameras(session)
        if session.recording is not None:
            self._ask(other_request=old.recording is None or make_request(old) != make_request(session))
        self.session_shown.emit(session)

    @property
    def session_to_save(self) -> Session:
        """The session with where the 3D views look, and the section's line."""
        return replace(self.session, cameras=self.views.cameras.get_cameras(self.views.scene), section=self.section)

    def set_cameras(self, cameras: Mapping[str, tuple[float, ...]]) -> None:
        """Have the 3D views look so, once what the session opens is there."""
        self.views.cameras.request_cameras(cameras, self.views.scene if self._is_open() and not self._opening else None)

    def set_observation_outline(self, visible: bool) -> None:
        """Whether to outline what the target really felt."""
        if visible != self._beside:
            self._beside = visible
            self.refresh()

    def set_comparison_mode(self, versus: ComparisonMode) -> None:
        """What every column shows beside, or in place of, what was worked out."""
        self.views.comparison_mode = versus
        for name in get_args(ComparisonMode)[1:]:
            self.window.actions_by_name[f"show_{name}"].setChecked(name == versus)
        self.refresh()

    def refresh(self) -> None:
        """Ask for the session's frame again."""
        if self.session.recording is not None and not self._closed:
            self._ask(other_request=False)

    def submit_priority(self, work: JobFunction) -> int:
        """Run something brief on the frame at hand in place of its stages; returns its ticket, 0 if none is open.

        Stages that were on their way are dropped: `refresh` asks for them again, and until then it is not idle.
        """
        if self._opening or self._closed or self.views.translation is None:
            return 0
        owed, interrupt = self._waits or self._owed, self._waits or self.job.newest_ticket == self._background
        self._rest()
        self._owed = owed
        self.views.mark_dropped()
        self._ticket = 0  # what is dropped now is not missed
        self._ticket = self.job.submit(work, interrupt=interrupt)
        return self._ticket

    def submit_background(self, work: JobFunction) -> int:
        """As `ahead`, for what anything else goes before: the controller counts as idle meanwhile."""
        self._background = self.submit_priority(work)
        return self._background

    def show_only(self, name: str) -> None:
        """One stage alone, or all again; what is hidden is not worked out."""
        alone = self.window.visible_columns() == (name,)
        self.views.show_only(None if alone else name)
        self.refresh()

    def reset_view(self) -> None:
        """Look at every 3D view as at first."""
        self.views.reset_cameras(self.session)

    def cancel(self) -> None:
        """Stop the work, and take the crosshairs away."""
        self.job.cancel()
        self.probe.clear_trace()

    def close(self) -> None:
        """Stop the background, then everything OpenGL."""
        if self._closed:
            return
        self._closed = True
        self.undo_stack.blockSignals(True)  # it outlives the actions that listen to it
        self.window.timeline.play(on=False)
        self._stale.stop()
        self.closing.emit()
        self.job.close()
        self.evaluator.close()
        self.views.close()
        self.relay.close()

    @property
    def is_closed(self) -> bool:
        """Whether nothing is worked out any more."""
        return self._closed

    @property
    def is_idle(self) -> bool:
        """Whether everything asked for is on screen, or has failed."""
        busy = self.job.is_busy and self.job.newest_ticket != self._background
        return not (busy or self._stale.isActive() or self._waits or self._owed)

    def handle_part(self, ticket: int, part: object) -> None:
        """Show a part of the result; parts for another recording come too late."""
        if ticket < self._wanted_since or self._closed:
            return
        self._opening = 0
        if isinstance(part, InitialFrame):
            self.session = replace(self.session, frame=part.index)
            self._show_controls()
        elif isinstance(part, Translation) and part is not self.views.translation:
            named = replace(self.session, target=part.target.name, frame=min(self.session.frame, part.n_frames - 1))
            seen = set(self.window.visible_columns())
            self._open, self._failing = {make_request(self.session), make_request(named)}, set()
            self.session = named
            self.views.show_translation(part, named)
            self._show_controls()
            if not seen.issuperset(self.window.visible_columns()):
                self.refresh()  # the route has columns that were not seen when it, or a frame since, was asked for
        elif isinstance(part, SourcePreview | StagePreview):
            self.views.show_stage(part, newest=ticket == self._ticket)
            if isinstance(part, SourcePreview):
                self.window.timeline.show_frame(self.session.frame, part.frame.time_s)
        if ticket == self._ticket:
            self.views.mark_running()

    def handle_frame(self, ticket: int, shown: object) -> None:
        """Show what belongs to a whole frame."""
        if ticket < self._wanted_since or self._closed or not isinstance(shown, EvaluatedFrame):
            return
        self.latest_frame = shown
        self.views.show_frame_summary(shown, comparable=shown.settings == self.session.settings)
        if ticket == self._ticket:
            self._rest()
            self.frame_shown.emit(shown.index)

    def handle_failure(self, ticket: int, error: object) -> None:
        """Say what went wrong; what could not be opened is undone, so that what was open stays usable."""
        if ticket < self._wanted_since or self._closed or not isinstance(error, BaseException):
            return
        if ticket == self._ticket:
            not_opened = self._opening == ticket and not self._is_open()  # a frame of what is open may be damaged
            self._rest()
            if not_opened:
                self._take_back()
            else:
                self.views.mark_failed(error)
        self.show_problem(error)

    def handle_cancellation(self, ticket: int) -> None:
        """Nothing more will come for this ticket."""
        if ticket == self._ticket and not self._closed:
            self.views.mark_cancelled()
            self._rest()

    def handle_progress(self, ticket: int, fraction: float, text: str) -> None:
        """Show how far the newest work is."""
        if ticket == self._ticket and self._waits:
            self.window.show_progress(fraction, text)

    def _take_back(self) -> None:
        """Go back to a session that is open, or may be, but stay on the frame that was chosen meanwhile."""
        failed, known = self.session, list_sessions(self.undo_stack)
        self._failing.add(make_request_if_open(failed))
        place = find_undo_target(known, self.undo_stack.index(), self._open, self._failing)
        if place is None:
            self.views.mark_cancelled()
            return
        self._passing = True  # what lies between is not asked for
        self.undo_stack.setIndex(place)
        self._passing = False
        self.show_session(known[place])
        if self.session.recording == failed.recording:
            self.choose_frame(failed.frame)

    def _is_open(self) -> bool:
        return make_request_if_open(self.session) in self._open

    @property
    def methods(self) -> tuple[Method, ...]:
        """Those of the session's route, one a slot."""
        return self.catalogue.methods(self.session.route, self.session.methods)

    @property
    def sensor_kinds(self) -> Mapping[str, str]:
        """Key of a method -> the kind of sensor that it looks at; nothing where nothing is open."""
        opened = self.views.translation
        if opened is None:
            return {}
        kind = {"source": opened.source.kind, "target": opened.target.kind}
        return {method.key: kind[self.catalogue.stage(method.stage).sensor_role] for method in self.methods}

    def _show_controls(self) -> None:
        show_controls(self.window, self.session, self.methods, self.catalogue, self.sensor_kinds)

    def _ask(self, *, other_request: bool) -> None:
        session, wanted = self._drafted(), self.window.visible_columns()
        show = partial(
            self.evaluator.evaluate_frame, compared=self._beside, seen=lambda: self.views.translation,
            with_truth=bool(self.views.comparison_mode) or session.layout.name == "demo",
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
        self.views.mark_all_pending()
        self.window.timeline.show_ready(ready=False)
        if not self._stale.isActive():
            self._stale.start()

    def _drafted(self) -> Session:
        """The session, or while a parameter is dragged one that is quick to show from there on."""
        methods, dragged = self.methods, self.window.parameters.dragged_key
        first = next((i for i, method in enumerate(methods) if method.key == dragged), len(methods))
        return self.session.with_draft_params(methods[first:])

    def _rest(self, *, owed: bool = False) -> None:
        self._waits, self._owed = False, owed
        self._opening = 0
        self._stale.stop()
        self._young.stop()
        self.window.show_progress(None)
        self.window.timeline.show_ready(ready=True)
