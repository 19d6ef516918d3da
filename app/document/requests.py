"""Requests: what a session asks the pipeline for, and which request for the stages is on its
way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from contextlib import closing
from dataclasses import replace
from typing import Literal

from app.session.state import REQUEST_FIELDS, Session
from pipeline.core.errors import FileProblem
from pipeline.core.frozen import frozen
from pipeline.core.graph import Method
from pipeline.core.params import list_settings
from pipeline.core.progress import Progress, reading_reported_to
from pipeline.io import open_recording
from pipeline.sensors.alignment import read_alignment
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.photometric import DepthParams
from pipeline.stages.depth.stage import PHYSICS
from pipeline.stages.networks.samplers import NO_CONDITION_DROPOUT
from pipeline.stages.networks.weights import NoWeights, Weights
from pipeline.translation.catalogue import Catalogue
from pipeline.translation.translate import Request, Translation, open_translation


def make_request(session: Session) -> Request:
    """Build the request that opens a session with a recording."""
    fields = {name: getattr(session, name) for name in REQUEST_FIELDS}
    methods = tuple(sorted(session.methods.items()))
    weights = tuple(sorted(session.weights.items()))
    return Request(**fields, methods=methods, weights=weights)


def make_request_if_open(session: Session) -> Request | None:
    """Build the request of a session; None without a recording."""
    return None if session.recording is None else make_request(session)


def find_undo_target(
    sessions: Sequence[Session], at: int, opened: Set[Request | None], failing: Set[Request | None]
) -> int | None:
    """Return the undo index to go back to from `at`, which could not be opened.

    None if there is none.

    It is the nearest index whose request is open. If a change after an undo has removed that one
    from the stack, it is the nearest earlier index that is not known to fail.
    """
    requests = [make_request_if_open(session) for session in sessions]
    earlier = range(at - 1, -1, -1)
    there = [i for i in (*earlier, *range(at + 1, len(requests))) if requests[i] in opened]
    untried = [i for i in earlier if requests[i] not in {None, *failing}]
    return next(iter(there + untried), None)


def get_depth_params(session: Session, methods: Sequence[Method]) -> DepthParams:
    """Return the parameters of a session's depth by one of these methods, used for both sensors
    of a comparison.
    """
    depth = next((method for method in methods if issubclass(method.params, DepthParams)), PHYSICS)
    params = session.get_params(depth)
    assert isinstance(params, DepthParams)
    return params


def open_request(request: Request, catalogue: Catalogue) -> Translation:
    """Open a translation, to a default target if none is named; raises TouchError."""
    if not request.target:
        request = replace(request, target=_choose_target(request))
    translation = open_translation(request, catalogue)
    if translation.n_frames == 0:
        translation.close()
        raise FileProblem("the recording holds no frame; choose another", request.recording)
    return translation


def apply_session(session: Session, opened: Translation) -> Translation:
    """Return an open translation with the offsets and parameters of a session."""
    return replace(
        opened,
        alignment=session.offsets.apply_to(opened.alignment),
        params=session.collect_params(opened.methods),
    )


def _choose_target(request: Request) -> str:
    """Return the target of the alignment file, else another sensor of the recording, else one of
    another kind.
    """
    with closing(
        open_recording(
            request.recording,
            sensor=request.source,
            stream=request.stream,
            reference=request.reference,
            reference_frames=request.reference_frames,
            depth_unit=request.depth_unit,
        )
    ) as recording:
        stated = load_sensor(request.source).name if request.source else ""
        source = request.source or recording.stream(request.stream or stated).sensor
        others = [s.sensor for s in recording.streams if s.sensor not in ("", source)]
    file = None if request.alignment is None else read_alignment(request.alignment)
    if file is not None and file.source == source:
        return file.target
    # of a sensor that nobody knows, which does not open
    kind = load_sensor(source).kind if source else ""
    if others:
        return next((name for name in others if load_sensor(name).kind != kind), others[0])
    return "soft_bubble" if kind == "gel" else "gelslim"


def explain_unavailable(opened: Translation, progress: Progress) -> Mapping[str, Mapping[str, str]]:
    """Method key -> parameter -> why it cannot act; reads the weights."""
    with reading_reported_to(progress):
        weights = opened.weights
    return {
        m.key: _explain(m, weights[m.weights_name]) for m in opened.methods if m.weights is not None
    }


def _explain(method: Method, weights: object) -> Mapping[str, str]:
    if isinstance(weights, NoWeights):
        settings = list_settings(method.params()).items()
        return {
            name: f"no network for this pair: {weights.why}"
            for name, (_, setting) in settings
            if setting.pinned
        }
    has_dropout = not isinstance(weights, Weights) or weights.trained_with_condition_dropout
    return {} if has_dropout else {"guidance": NO_CONDITION_DROPOUT}


_INTERRUPT_DELAY_S = 0.5  # a younger request finishes, so that a drag shows intermediate results


@frozen
class Requests:
    """State of the requests for stages.

    Every change returns another value. Tickets are those of `LatestJob`.
    """

    # running: stages are computed. draft: the same, for a dragged parameter, whose stage is not on
    # screen yet. stale: the stages were dropped for a short job and must be requested again.
    state: Literal["idle", "running", "draft", "stale"] = "idle"
    ticket: int = 0  # newest request, or short job in place of one; 0 = none
    oldest_shown: int = 0  # parts of older tickets are of another recording
    opening: int = 0  # ticket that opens a recording; 0 = none
    background: int = 0  # newest job of lowest priority
    draft_stage: str = ""  # whose draft is computed
    started_s: float = 0.0  # when a request last cancelled the one before

    @property
    def is_running(self) -> bool:
        """Whether stages are computed."""
        return self.state in ("running", "draft")

    def must_interrupt(self, now_s: float, *, opens: bool) -> bool:
        """Return whether a new request cancels the running one.

        A draft, or a young request, finishes first.
        """
        is_young = self.is_running and now_s - self.started_s < _INTERRUPT_DELAY_S
        return opens or not (self.state == "draft" or is_young)

    def request(
        self, ticket: int, now_s: float, *, opens: bool, interrupts: bool, draft_stage: str = ""
    ) -> Requests:
        """Request stages; `opens` another recording or sensors, whose parts alone are shown from
        now on.
        """
        return replace(
            self,
            state="draft" if draft_stage else "running",
            draft_stage=draft_stage,
            ticket=ticket,
            oldest_shown=ticket if opens else self.oldest_shown,
            opening=ticket if opens or self.opening else 0,
            started_s=now_s if interrupts else self.started_s,
        )

    def yield_to(self, ticket: int, *, background: bool) -> Requests:
        """Let a short job take the place of the stages, which are stale then if they were on
        their way.
        """
        state = "idle" if self.state == "idle" else "stale"
        return replace(
            self.end(),
            state=state,
            ticket=ticket,
            background=ticket if background else self.background,
        )

    def show_part(self, stage: str = "") -> Requests:
        """Show a part: the recording is open, and the draft of its stage is on screen."""
        is_awaited = self.state == "draft" and stage == self.draft_stage
        return replace(self, opening=0, state="running" if is_awaited else self.state)

    def end(self) -> Requests:
        """End the request: finished, failed or cancelled."""
        return replace(self, state="idle", opening=0)

    def close_recording(self, newest_ticket: int) -> Requests:
        """Show nothing more of any request up to `newest_ticket`."""
        return replace(self.end(), ticket=0, background=0, oldest_shown=newest_ticket + 1)

    def accepts(self, ticket: int) -> bool:
        """Return whether results of this ticket are still shown."""
        return ticket >= self.oldest_shown
