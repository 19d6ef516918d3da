"""The session and its background computation: the newest request is the one on screen."""

import time
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

from PyQt6.QtCore import QSignalBlocker, QTimer, pyqtSignal

from app.document.evaluator import EvaluatedFrame, Evaluator, InitialView
from app.document.requests import Requests, find_undo_target, make_request, make_request_if_open
from app.document.session_document import SessionDocument
from app.document.stage_views import StageViews
from app.session.state import DISPLAY_KEY, Session
from app.session.undo import list_sessions
from app.views.pixel_trace import PixelProbe
from app.views.stage_previews import SourcePreview, StagePreview
from app.window.jobs import JobFunction, LatestJob
from app.window.logs import LogRelay
from app.window.main_window import MainWindow
from pipeline.core.graph import Method
from pipeline.core.params import Setting, Value, list_settings
from pipeline.sensors.alignment import AlignmentMismatch
from pipeline.stages.networks.samplers import raise_steps
from pipeline.translation.catalogue import BUILT_IN, Catalogue, Route
from pipeline.translation.translate import Request, Translation
from pipeline.translation.truth_view import ComparisonMode
from widgets.style.notification_bar import Choice
from widgets.style.styling import make_single_shot_timer

_STALE_DELAY_MS = 150  # columns not replaced within this time are marked stale
_STEPS_RAISED = "denoising steps raised to 8: guidance acts from 4 steps on"


class SessionController(SessionDocument):
    """Turns session changes into background requests, and passes the results to the views."""

    frame_shown = pyqtSignal(int)
    session_shown = pyqtSignal(object)  # Session; `app.shell.connections` lists all that follows
    translation_shown = pyqtSignal()
    opening_cancelled = pyqtSignal()
    alignment_dropped = pyqtSignal(object)  # AlignmentMismatch
    remedies_changed = pyqtSignal()
    closing = pyqtSignal()
    termination_requested = pyqtSignal()  # by a signal, before closing without questions

    def __init__(self, window: MainWindow, catalogue: Catalogue = BUILT_IN) -> None:
        super().__init__(window, Session())
        self.relay = LogRelay(self)
        self.catalogue = catalogue
        self.job = LatestJob("stages", self)
        self.evaluator = Evaluator(catalogue)
        self.probe = PixelProbe(window)
        self.views = StageViews(window, self.probe)
        self.is_closed = False
        self.remedies: Sequence[Choice] = ()  # for the warnings of the frame on screen
        self.requests = Requests()
        self._extras: set[str] = set()  # that panels request
        # that are open: as requested, and with names resolved
        self._open_requests: set[Request | None] = {None}
        self._failed_requests: set[Request | None] = set()
        self._is_skipping = False  # over undo steps that need no computation
        self._dragged_key = ""  # method whose slider is held
        # ticket of the newest short job, and what its parts and its result go to
        self._short_job: tuple[int, Callable[[Any], object]] = 0, lambda _: None
        self.latest_frame: EvaluatedFrame | None = None  # the frame on screen
        self.failed_session = self.session  # that failed last
        self._stale_timer = make_single_shot_timer(self, _STALE_DELAY_MS, self.views.mark_stale)

    def choose_frame(self, frame: int) -> None:
        """Go to a frame."""
        self.change("go to frame", key="frame", frame=frame)

    def choose_params(self, key: str, params: object) -> None:
        """Set the parameters of a method or of the display; a drag is one undo step.

        Where guidance would not act for lack of denoising steps, these are raised, and the status
        bar says so.
        """
        words = "change display"
        given = params
        for method in self.methods:
            if method.key == key:
                old = self.session.get_params(method)
                given = raise_steps(old, params)
                words = self._describe_params_change(method, list_settings(old), given)
        self.change(words, key=f"params {key}", params={**self.session.params, key: given})
        if given != params:
            self.window.say(_STEPS_RAISED)

    def _describe_params_change(
        self, method: Method, before: Mapping[str, tuple[Value, Setting]], new: object
    ) -> str:
        """Return "change smoothing of depth" for one changed parameter, else the stage alone."""
        changed = [
            setting.label.lower()
            for name, (value, setting) in list_settings(new).items()
            if before[name][0] != value
        ]
        what = changed[0] if len(changed) == 1 else "parameters"
        return f"change {what} of {self.catalogue.stage(method.stage).title.lower()}"

    def hold_slider(self, key: str) -> None:
        """Compute drafts while a slider of a method is held; "" = it was let go."""
        self._dragged_key = key
        if not key:
            self.refresh()

    def choose_method(self, stage: str, name: str) -> None:
        """Compute a stage by another method.

        The route's own method, or "" for it, clears the choice.
        """
        default = self.route.methods.get(stage, "")
        methods = {**self.session.methods, stage: name or default}
        title = self.catalogue.method(stage, methods[stage]).title
        if methods[stage] == default:
            del methods[stage]
        self.change(
            f"choose {title} for {self.catalogue.stage(stage).title.lower()}", methods=methods
        )

    def show_session(self, session: Session) -> None:
        """Turn a session change into work: controls at once, stages when they are computed, then
        `session_shown`.
        """
        if self._is_skipping:
            return
        old = self.session
        self.session = session
        if session.recording != old.recording:
            self._close_recording(session.recording)
        if session.layout != self.window.current_layout:
            self.window.show_layout(session.layout)
        self._show_controls()
        if session.settings != old.settings:
            self.window.frames.model.clear_summaries()
        if session.cameras_linked != old.cameras_linked or session.display != old.display:
            self.views.reset_cameras(session)
        if session.recording is not None:
            is_other = old.recording is None or make_request(old) != make_request(session)
            self._request_stages(self._find_changed_stages(old), other_request=is_other)
        self.session_shown.emit(session)

    @property
    def session_to_save(self) -> Session:
        """The session with the current 3D cameras, section line and tick."""
        cameras = self.views.get_cameras()
        return replace(self.session, cameras=cameras, section=self.section, tick=self.tick)

    def set_cameras(self, cameras: Mapping[str, tuple[float, ...]]) -> None:
        """Set the cameras of the 3D views, once the session's recording is open."""
        is_open = self._is_open() and not self.requests.opening
        self.views.set_cameras(cameras, is_open=is_open)

    def request_extra(self, extra: Literal["observation", "truth"], *, wanted: bool) -> None:
        """Compute the outline of the target's own touch or the truth of every stage as well, or
        no longer.
        """
        if wanted != (extra in self._extras):
            self._extras ^= {extra}
            self.refresh()

    def toggle_comparison_mode(self, mode: ComparisonMode) -> None:
        """Choose how every column shows the truth, or no longer."""
        self.set_comparison_mode("" if self.views.comparison_mode == mode else mode)

    def set_comparison_mode(self, mode: ComparisonMode) -> None:
        """Choose how every column shows the truth."""
        self.views.comparison_mode = mode
        for name in get_args(ComparisonMode)[1:]:
            self.window.actions_by_name[f"show_{name}"].setChecked(name == mode)
        self.refresh()

    def refresh(self) -> None:
        """Compute the session's frame again."""
        if self.session.recording is not None and not self.is_closed:
            self._request_stages(frozenset(), other_request=False)

    def submit_priority(
        self, work: JobFunction, then: Callable[[Any], object], *, background: bool = False
    ) -> None:
        """Run a short job on the open recording, if any, instead of the stages.

        `then` gets its parts and its result, unless another job takes its place.

        Running stages are dropped; `refresh` requests them again, and until then the controller is
        not idle. It counts as idle during a job in the `background`, which has the lowest priority.
        """
        if self.requests.opening or self.is_closed or self.views.translation is None:
            return
        interrupt = self.requests.is_running or self.job.newest_ticket == self.requests.background
        old = self.requests
        self._end_request()
        self.views.mark_dropped()
        ticket = self.job.submit(work, interrupt=interrupt)
        self.requests = old.yield_to(ticket, background=background)
        self._short_job = ticket, then

    def cancel(self) -> None:
        """Cancel the computation, and clear the probe."""
        self.job.cancel()
        self.probe.clear_trace()

    def close(self) -> None:
        """End the background threads, then release OpenGL."""
        if self.is_closed:
            return
        self.is_closed = True
        self.undo_stack.blockSignals(True)  # it outlives the actions connected to it
        self.window.timeline.play(on=False)
        self.closing.emit()
        for timer in self.findChildren(QTimer):  # those of all features, too
            timer.stop()
        self.job.close()
        self.evaluator.close()
        self.views.scene.close()
        self.relay.close()

    @property
    def is_idle(self) -> bool:
        """Whether everything requested is on screen or has failed."""
        is_busy = self.job.is_busy and self.job.newest_ticket != self.requests.background
        return not is_busy and self.requests.state == "idle"

    def _accepts(self, ticket: int) -> bool:
        return not self.is_closed and self.requests.accepts(ticket)

    def handle_part(self, ticket: int, part: object) -> None:
        """Show a part of the result; parts of an older recording are dropped."""
        if not self._accepts(ticket):
            return
        before = self.requests
        self.requests = before.show_part(part.result.name if isinstance(part, StagePreview) else "")
        if isinstance(part, InitialView):
            session = self.session.with_display(part.display)
            frame = part.index if session.frame < 0 else session.frame
            self.session = replace(session, frame=frame)
            self._show_controls()
        elif isinstance(part, Translation) and part is not self.views.translation:
            resolved = replace(
                self.session,
                target=part.target.name,
                frame=min(self.session.frame, part.n_frames - 1),
            )
            visible = set(self.window.visible_columns())
            self._open_requests = {make_request(self.session), make_request(resolved)}
            self._failed_requests = set()
            self.session = resolved
            self.views.show_translation(part, resolved)
            self.translation_shown.emit()
            self._show_controls()
            if not visible.issuperset(self.window.visible_columns()):
                self.refresh()  # the route has columns that the request did not include
        elif isinstance(part, SourcePreview | StagePreview):
            self.views.show_stage(part, is_newest=ticket == self.requests.ticket)
            if self.requests.state != before.state:  # the draft is on screen
                self.job.skip_to_waiting()
            if isinstance(part, SourcePreview):
                self.window.timeline.show_frame(self.session.frame, part.frame.time_s)
        elif ticket == self._short_job[0]:
            self._short_job[1](part)
        if ticket == self.requests.ticket:
            self.views.mark_running()

    def handle_frame(self, ticket: int, shown: object) -> None:
        """Show the summary of a finished frame."""
        if not self._accepts(ticket):
            return
        if not isinstance(shown, EvaluatedFrame):
            if ticket == self._short_job[0]:
                self._short_job[1](shown)
            return
        self.latest_frame = shown
        self.views.show_frame_summary(shown, is_comparable=shown.settings == self.session.settings)
        if ticket == self.requests.ticket:
            self._end_request()
            self.frame_shown.emit(shown.index)

    def handle_failure(self, ticket: int, error: object) -> None:
        """Show an error with what mends it.

        If an open recording does not open with another file, undo that.
        """
        if not self._accepts(ticket) or not isinstance(error, BaseException):
            return
        if ticket == self.requests.ticket:
            # else one frame is damaged
            cannot_open = self.requests.opening == ticket and not self._is_open()
            self._end_request()
            self.failed_session = self.session
            if cannot_open and isinstance(error, AlignmentMismatch) and self._drop_alignment():
                self.alignment_dropped.emit(error)
                return
            if cannot_open and self.views.translation is not None:
                self._undo_opening()
            else:
                self.views.mark_failed(error)
        self.show_problem(error)

    def handle_cancellation(self, ticket: int) -> None:
        """Show that the request was cancelled."""
        # A request that a newer one replaces before it runs is cancelled before the newer one is
        # known here.
        if ticket == self.requests.ticket == self.job.newest_ticket and not self.is_closed:
            self.views.mark_cancelled()
            self._end_request()
            if self.views.translation is None:
                self.opening_cancelled.emit()

    def handle_progress(self, ticket: int, fraction: float, text: str) -> None:
        """Show the progress of the newest request."""
        if ticket == self.requests.ticket and self.requests.is_running:
            self.window.show_progress(fraction, text)

    def _close_recording(self, following: Path | None) -> None:
        """Show nothing of the recording on screen, as another one is opened, or none."""
        self.latest_frame = None
        self._open_requests = {None}
        self.views.clear_recording("" if following is None else following.name)
        if following is None:
            self.job.cancel()
            self._end_request()
            self.requests = self.requests.close_recording(self.job.newest_ticket)

    def _undo_opening(self) -> None:
        """Undo to the nearest session that is open, but stay on the frame chosen meanwhile."""
        failed = self.session
        sessions = list_sessions(self.undo_stack)
        self._failed_requests.add(make_request_if_open(failed))
        index = find_undo_target(
            sessions, self.undo_stack.index(), self._open_requests, self._failed_requests
        )
        if index is None:
            self.views.mark_cancelled()
            return
        self._skip_to(index)
        self.show_session(sessions[index])
        if self.session.recording == failed.recording:
            self.choose_frame(failed.frame)

    def _drop_alignment(self) -> bool:
        """Open without the alignment what was changed around it.

        False if the alignment itself was chosen last.
        """
        failed = self.session
        index = self.undo_stack.index() - 1
        text = self.undo_stack.undoText()
        if index < 0:
            return False
        before = list_sessions(self.undo_stack)[index]
        if before.alignment != failed.alignment:
            return False
        self._skip_to(index)
        self.session = before
        self.push_session(failed.with_updates(alignment=None), text)
        return True

    def _skip_to(self, index: int) -> None:
        """Go to a place of the undo stack; what lies between is not computed."""
        self._is_skipping = True
        self.undo_stack.setIndex(index)
        self._is_skipping = False

    def _is_open(self) -> bool:
        return make_request_if_open(self.session) in self._open_requests

    @property
    def methods(self) -> tuple[Method, ...]:
        """Methods of the session's route, one per stage."""
        opened = self.views.translation
        kinds = None if opened is None else opened.sensor_kinds
        return self.catalogue.methods(self.route.name, self.session.methods, kinds)

    @property
    def route(self) -> Route:
        """The session's route, or the default for what is open."""
        opened = self.views.translation
        has_mesh = opened is not None and opened.mesh is not None
        return self.catalogue.route(self.session.route, has_mesh=has_mesh)

    @property
    def sensor_kinds(self) -> Mapping[str, str]:
        """Method key -> kind of sensor it reads; {} if nothing is open."""
        opened = self.views.translation
        if opened is None:
            return {}
        stage = self.catalogue.stage
        return {m.key: opened.sensor_kinds[stage(m.stage).sensor_role] for m in self.methods}

    def _show_controls(self) -> None:
        """Show the session on the controls, without change signals.

        Only the parameters for the sensors' kinds are shown; those that cannot act are greyed out.
        """
        window, session, opened = self.window, self.session, self.views.translation
        window.timeline.show_frame(session.frame)
        window.frames.show_frame(session.frame)
        for stage in self.catalogue.stages:
            for method in self.catalogue.list_choices(stage.name):
                if method.kinds and opened is not None:
                    window.columns[stage.name].enable_method(
                        method.name, method.fits(opened.sensor_kinds[stage.sensor_role])
                    )
                window.parameters.show_params(method.key, session.get_params(method))
        window.parameters.show_params(DISPLAY_KEY, session.display)
        kinds = self.sensor_kinds
        groups = {method.key: kinds.get(method.key, "") for method in self.methods}
        window.parameters.show_groups({**groups, DISPLAY_KEY: ""})
        for method in self.methods:
            column = window.columns[method.stage]
            column.show_method(method.name)
            window.look.filmstrip.thumbnails[method.stage].show_method(column.method_title)
            why_not = self.evaluator.unavailable.get(method.key, {})
            window.parameters.show_unavailable(method.key, why_not)
        chosen = {"source": session.source, "target": session.target, "route": self.route.name}
        for name, value in chosen.items():
            box = getattr(window, name)
            with QSignalBlocker(box):
                box.setCurrentIndex(max(0, box.findData(value)))
        actions = window.actions_by_name
        actions["link_cameras"].setChecked(session.cameras_linked)
        actions["close_mesh"].setEnabled(session.mesh is not None)
        actions["close_weights"].setEnabled(bool(session.weights))

    def _find_changed_stages(self, old: Session) -> Set[str] | None:
        """Return what a session change reaches first: stages or the alignment; None = all."""
        new = self.session
        before = replace(old, methods=new.methods)
        if before.recording is None or make_request(before) != make_request(new):
            return None
        if (old.frame, old.display) != (new.frame, new.display):
            return None
        changed = {
            m.stage
            for m in self.methods
            if old.get_params(m) != new.get_params(m)
            or old.methods.get(m.stage) != new.methods.get(m.stage)
        }
        return changed if old.offsets == new.offsets else changed | {"alignment"}

    def _request_stages(self, changed: Set[str] | None, *, other_request: bool) -> None:
        session = self._session_to_compute()
        stages = self.window.visible_columns()
        evaluate = partial(
            self.evaluator.evaluate_frame,
            with_observation="observation" in self._extras,
            truth_of=self._list_compared_stages(stages),
        )
        now_s = time.monotonic()
        interrupts = self.requests.must_interrupt(now_s, opens=other_request)
        ticket = self.job.submit(
            lambda report: evaluate(session, stages, report), interrupt=interrupts
        )
        self.requests = self.requests.request(
            ticket,
            now_s,
            opens=other_request,
            interrupts=interrupts,
            draft_stage=self._dragged_key.partition("/")[0],
        )
        self.views.mark_pending(changed)
        self.window.timeline.show_ready(ready=False)
        if not self._stale_timer.isActive():
            self._stale_timer.start()

    def _list_compared_stages(self, stages: tuple[str, ...]) -> tuple[str, ...]:
        """List the stages to show with their truth."""
        if self.views.comparison_mode or "truth" in self._extras:
            return stages
        return ("touch",) if self.window.shows_true_touch else ()

    def _session_to_compute(self) -> Session:
        """Return the session; while a parameter is dragged, with draft parameters from its stage
        on.
        """
        keys = [method.key for method in self.methods]
        if self._dragged_key not in keys:
            return self.session
        return self.session.with_draft_params(self.methods[keys.index(self._dragged_key) :])

    def _end_request(self) -> None:
        self.requests = self.requests.end()
        self._stale_timer.stop()
        self.window.show_progress(None)
        self.window.timeline.show_ready(ready=True)
